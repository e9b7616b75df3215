"""Posteriors over samples of the prior: for few beams, which leave a large part of all poses possible."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....arrays import Array, IntArray
from ....filters.problem import Problem
from ....filters.space import StateSpace
from .draws import prior_states

REACH_STDS = 8.0  # Gaussian readings further from an expected range weigh nothing
STEP_STDS = 4.0  # between samples that are put in order by a second beam
NEGLIGIBLE = -40.0  # log of a weight, over the largest, that adds nothing


@dataclass(frozen=True)
class SampledPosteriors:
    """What posteriors over samples come down to.

    Attributes:
        mean: (K, n); angles by their circular mean. NaN where no sample fits.
        covariance: (K, n, n); angles by the short way round from that mean.
        effective: How many samples of equal weight each is worth, (K,).
        direction: Length of the mean direction of the heading, 0 to 1, (K,): near 0 there is no circular
            mean. 1 where there is no angle.
    """

    mean: Array
    covariance: Array
    effective: Array
    direction: Array


@dataclass(frozen=True)
class SampledPoses:
    """States drawn from the prior, and the ranges expected there.

    Attributes:
        problem: The problem; one measurement.
        states: (N, n); in the order of a measured beam's range, in steps, and within a step of another's.
        expected: m, (N, B).
    """

    problem: Problem
    states: Array
    expected: Array

    @staticmethod
    def of(problem: Problem, count: int, rng: np.random.Generator) -> SampledPoses:
        """Draw so many."""
        states = prior_states(problem, count, rng)
        expected = problem.sensor.expected(states)
        drawn = SampledPoses(problem, states, expected)
        first, last = drawn._beams
        order = np.lexsort((expected[:, last], drawn._steps(expected[:, first])))
        return SampledPoses(problem, states[order], expected[order])

    @property
    def _beams(self) -> tuple[int, int]:
        """The beams by which samples are in order: the first and the last that are measured."""
        measured = np.flatnonzero(~self.problem.sensor.blind)
        return int(measured[0]), int(measured[-1])

    def _steps(self, ranges: Array) -> Array:
        """In which step of the first beam ranges lie; all in one for noise that is not Gaussian."""
        stds = self.problem.sensor.gaussian_stds
        first, last = self._beams
        if stds is None or first == last:
            return np.zeros(len(ranges))
        return np.asarray(np.floor(ranges / (STEP_STDS * stds[first])))

    @cached_property
    def _starts(self) -> tuple[Array, IntArray]:
        """The steps that hold samples, and where each begins, with the end of the last."""
        steps, starts = np.unique(self._steps(self.expected[:, self._beams[0]]), return_index=True)
        return steps, np.append(starts, len(self.expected))

    def posteriors(self, readings: Array) -> SampledPosteriors:
        """Of readings (K, B), m."""
        found = [self._posterior(reading) for reading in readings]
        return SampledPosteriors(*(np.array(part) for part in zip(*found, strict=True)))

    def _posterior(self, reading: Array) -> tuple[Array, Array, float, float]:
        space = self.problem.space
        parts = self._near(reading)
        expected = np.concatenate([self.expected[part] for part in parts])
        logs = self.problem.sensor.log_density(reading, expected)
        if not np.isfinite(logs.max(initial=-np.inf)):
            return np.full(space.size, np.nan), np.full((space.size, space.size), np.nan), 0.0, 0.0
        logs -= logs.max()
        counts = logs > NEGLIGIBLE
        weights = np.exp(logs[counts])
        weights /= weights.sum()
        states = np.concatenate([self.states[part] for part in parts])[counts]
        mean, covariance = space.moments(states, weights)
        share = float(weights @ weights)
        if share < 1.0:
            covariance /= 1.0 - share  # what deviations from the samples' own mean fall short of
        return mean, covariance, 1 / share, _direction(space, states, weights)

    def _near(self, reading: Array) -> list[slice]:
        """Where samples lie that a reading may come from."""
        stds = self.problem.sensor.gaussian_stds
        if stds is None:
            return [slice(None)]
        ends = reading[:, None] + REACH_STDS * stds[:, None] * np.array([-1.0, 1.0])
        first, last = self._beams
        steps, starts = self._starts
        low, high = self._steps(ends[first])
        within = range(*np.searchsorted(steps, (low, high + 0.5)))
        parts = []
        for step in within:
            begin, end = starts[step], starts[step + 1]
            parts.append(slice(*(begin + np.searchsorted(self.expected[begin:end, last], ends[last]))))
        return parts or [slice(0)]


def _direction(space: StateSpace, states: Array, weights: Array) -> float:
    """Length of the mean direction, the least of all angles; 1 where there are none."""
    angles = states[:, space.is_angle]
    return float(np.abs(weights @ np.exp(1j * angles)).min(initial=1.0))
