"""Moments of a pose by the exact positions at each heading: a reference for unknown headings.

At a known heading the evidence and the moments of the position are exact (`rangefix.filters.exact`); what is
left is an integral over one angle. It is looked for with noise so wide that no peak slips through a grid of
headings, and then summed up by Gauss-Legendre rules over intervals that are halved until two halves agree
with the whole. It shares no search, lattice or cell with the filters for unknown headings. As a script it
prints what the adaptive filter is off by: `python -m tests.filters.adaptive.heading_oracle circle 1000 1040`.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rangefix.arrays import TWO_PI, Array, wrap
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.filters.exact import ExactPositionFilter

from ..families import Drawn, draw

SEARCH_STEP = 0.02  # rad between the headings of the search
MARGIN_NATS = 30.0  # below the best at which an interval is left out
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
NARROW = 1e-3  # rad: an interval that small, and so unlikely, is not halved any more
TOLERANCE = 1e-3  # of all moments, in deviations, that two halves may differ from their whole by


@dataclass(frozen=True)
class Known:
    """Mean (3,), covariance (3, 3), log evidence and how many headings it took."""

    mean: Array
    covariance: Array
    log_evidence: float
    headings: int


def at_heading(problem: Problem, heading: float, reading: Array, wider: float = 0.0) -> Array:
    """Log evidence, mean x1, x2 and covariance 11, 12, 22 at a known heading, (6,)."""
    space = position_space(heading)
    sensor = problem.sensor
    assert isinstance(sensor, Rangefinder)
    noise = sensor.noise
    if wider:
        assert isinstance(noise, Gaussian)
        noise = Gaussian(np.asarray(noise.std) + wider)
    there = Rangefinder(sensor.room, sensor.bearings, noise, space, max_range=sensor.max_range)
    exact = ExactPositionFilter(Problem(space, Stationary(space), there, Uniform(sensor.room, space)))
    rngs = [np.random.default_rng(0)]
    mean, covariance, log_evidence = exact.estimate(
        exact.update(exact.init(exact.problem.prior, rngs), reading[None], rngs)
    )
    return np.array(
        [log_evidence[0], *mean[0], covariance[0, 0, 0], covariance[0, 0, 1], covariance[0, 1, 1]]
    )


class Interval(NamedTuple):
    """An interval of headings, rad, and its nodes: heading, log weight, mean and covariance, (N, 7)."""

    low: float
    high: float
    nodes: Array

    @classmethod
    def of(cls, drawn: Drawn, low: float, high: float) -> Interval:
        headings = 0.5 * (low + high) + 0.5 * (high - low) * NODES
        rows = np.array([at_heading(drawn.problem, at, drawn.readings[0]) for at in headings])
        logs = np.log(0.5 * (high - low) * WEIGHTS) + rows[:, 0]
        return cls(low, high, np.column_stack([headings, logs, rows[:, 1:]]))

    @property
    def log_mass(self) -> float:
        return float(np.logaddexp.reduce(self.nodes[:, 1]))

    def halves(self, drawn: Drawn) -> list[Interval]:
        middle = 0.5 * (self.low + self.high)
        return [Interval.of(drawn, self.low, middle), Interval.of(drawn, middle, self.high)]


def known(drawn: Drawn) -> Known:
    """The posterior of a problem of any heading after its first reading."""
    prior, reading = drawn.problem.prior, drawn.readings[0]
    assert isinstance(prior, Uniform)
    first, last = prior.headings or (0.0, TWO_PI)
    ends = np.linspace(first, last, int(np.ceil((last - first) / SEARCH_STEP)) + 1)
    reach = 0.5 * (ends[1] - ends[0]) * float(np.where(np.isfinite(reading), reading, 0.0).max())
    middles = 0.5 * (ends[1:] + ends[:-1])
    rough = np.array([at_heading(drawn.problem, at, reading, reach)[0] for at in middles])
    likely = np.flatnonzero(rough > rough.max() - MARGIN_NATS)
    waiting = [Interval.of(drawn, ends[place], ends[place + 1]) for place in likely]
    headings, done = len(middles) + len(NODES) * len(waiting), []
    centre = moments(np.vstack([each.nodes for each in waiting]))[0]
    while waiting:
        whole = waiting.pop()
        halves = whole.halves(drawn)
        headings += 2 * len(NODES)
        both = np.vstack([half.nodes for half in halves])
        every = np.vstack([*(each.nodes for each in waiting), *done, both])
        std, best = np.sqrt(np.diagonal(moments(every)[1])), float(np.logaddexp.reduce(every[:, 1]))
        gap = np.abs(sums(whole.nodes, centre, std, best) - sums(both, centre, std, best)).max()
        if gap < TOLERANCE or (whole.log_mass < best - MARGIN_NATS and whole.high - whole.low < NARROW):
            done.append(both)
        else:
            waiting += halves
    nodes = np.vstack(done)
    log_evidence = float(np.logaddexp.reduce(nodes[:, 1])) - np.log(last - first)
    return Known(*moments(nodes), log_evidence, headings)


def sums(nodes: Array, centre: Array, std: Array, best: float) -> Array:
    """Mass, first and second moments about a centre in deviations, over exp(best)."""
    weights = np.exp(nodes[:, 1] - best)
    away = np.column_stack([nodes[:, 2:4] - centre[:2], wrap(nodes[:, 0] - centre[2])]) / std
    second = (away * weights[:, None]).T @ away
    return np.concatenate([[weights.sum()], weights @ away, second.ravel()])


def moments(nodes: Array) -> tuple[Array, Array]:
    """Mean (3,), with the circular mean of the heading, and covariance (3, 3) of weighted nodes."""
    weights = np.exp(nodes[:, 1] - nodes[:, 1].max())
    weights /= weights.sum()
    heading = float(np.angle(weights @ np.exp(1j * nodes[:, 0])))
    mean = np.array([*(weights @ nodes[:, 2:4]), heading])
    away = np.column_stack([nodes[:, 2:4] - mean[:2], wrap(nodes[:, 0] - heading)])
    covariance = (away * weights[:, None]).T @ away
    inner = weights @ nodes[:, 4:7]
    covariance[:2, :2] += [[inner[0], inner[1]], [inner[1], inner[2]]]
    return mean, covariance


def off_by(drawn: Drawn, reference: Known, accuracy: float = 0.02) -> tuple[float, float, float, float]:
    """The adaptive filter's errors of mean and covariance in deviations, what it states, and CPU seconds."""
    estimator, rng = AdaptivePointMassFilter(drawn.problem, accuracy), np.random.default_rng(0)
    begin = time.process_time()
    belief = estimator.update(estimator.init(drawn.problem.prior, rng), drawn.readings[0], rng)
    seconds = time.process_time() - begin
    mean, covariance, _ = estimator.estimate(belief)
    std = np.sqrt(np.diagonal(reference.covariance))
    off = np.abs(drawn.problem.space.difference(mean, reference.mean)) / std
    wrong = np.abs(covariance - reference.covariance) / np.outer(std, std)
    return float(off.max()), float(wrong.max()), estimator.error(belief), seconds


def main() -> None:
    family, first, last = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    for number in range(first, last):
        drawn = draw(family, number)
        begin = time.process_time()
        reference = known(drawn)
        took = time.process_time() - begin
        mean, covariance, stated, seconds = off_by(drawn, reference)
        beams = len(drawn.problem.sensor.bearings)
        told = f"mean off {mean:.4f}, covariance {covariance:.4f}, stated {stated:.4f}, {seconds:.2f} s"
        print(f"{family} {number}: {beams} beams, {told}; {reference.headings} headings in {took:.0f} s")


if __name__ == "__main__":
    main()
