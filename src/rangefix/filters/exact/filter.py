"""The exact posterior of a position: piecewise integration over the places that see the same walls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray, keep_whole
from ...compiled import in_threads
from ..estimate import BriefRepr, Estimate, brief
from ..measurement import check_measurement, count_runs
from ..models.correlated import refuse_shared_errors
from ..models.motion import refuse_moving
from ..prior_ends import FAR_REACH, Ends, may_lie_beyond, open_ends, out_of_reach
from ..problem import Prior, Problem
from ..sampling import gaussian_draws
from .any_noise import VALUES_TO_A_PIECE, moments_of_any
from .gaussian_noise import moments
from .nodes import Nodes, nodes_for
from .partition import Pieces
from .prior_parts import PriorPart, log_integral_of, parts_of
from .reading_tables import ReadingTables, weighed
from .rules import NODES_OF_RULES, Rules, rules
from .smooth_parts import NODES_WHERE_SMOOTH

ROUNDING_ERROR = 1e-7  # deviations of the posterior that corners of pieces, known to 1e-9 m, may shift it by
OTHER_ERROR = 1e-4  # the same of densities that are interpolated, and of parts that were left out
ROOM = 1 << 15  # for nodes, at first
NODES_OF_DRAWS = (18,) * len(NODES_OF_RULES)
MORE_NODES = 3  # in each rule, to see how far the answer depends on them
BEAMS_AT_ONCE = 128  # of some runs, whose densities are tabulated at once


@dataclass(frozen=True)
class ExactBelief:
    """A posterior as the readings that made it, and what they come down to.

    Attributes:
        readings: All measurements so far, (M, T, B), m.
        estimate: Mean, covariance and log evidence.
    """

    readings: Array
    estimate: Estimate

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class ExactPositionFilter(BriefRepr):
    """The exact posterior of an object that stands still and knows its heading.

    Beams then have fixed directions, and free space falls into convex pieces from which every beam meets one
    wall, so that every range is an affine function of the position. With Gaussian noise the posterior is a
    Gaussian cut off at the borders of each piece, and is integrated along its axes; with other noise pieces
    are halved until every beam's density is smooth. The pieces are worked out once and shared by all runs.

    Numerical errors are of the order of 1e-9 of the posterior's deviations with Gaussian noise and 1e-5 with
    other noise; `error` tells them. Where densities of many readings would take tens of thousands of
    halvings the answer is coarser. The yardstick of this package where it applies.

    Pieces cover a Gaussian prior to 6 deviations. Readings that lead farther, or fit nowhere there, are asked
    once more of pieces that cover it to 40; where those are too many, or end too early, `error` is inf.

    Args:
        problem: The problem: known heading, `Stationary`, a map of walls (`segments`), and a prior that is
            uniform, Gaussian or a mixture of such.
        most_pieces: The most pieces that map and beams may make.

    Raises:
        ValueError: If the problem is of another kind, there are too many pieces, or the pieces' ranges are
            not the map's.
    """

    problem: Problem
    most_pieces: int = 200_000

    def __post_init__(self) -> None:
        space = self.problem.space
        if space.names != ("x1", "x2"):
            raise ValueError("the exact filter is for a position x1, x2 with a known heading")
        refuse_moving(self.problem.motion, "the exact filter")
        refuse_shared_errors(self.problem.sensor, "the exact filter")
        keep_whole(self, "most_pieces", 1)
        self.parts  # noqa: B018 (refuses what does not fit)

    @cached_property
    def parts(self) -> tuple[PriorPart, ...]:
        """The components of the problem's prior."""
        return parts_of(self.problem, self._rules, self.most_pieces)

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> ExactBelief:
        """The prior, the same for all runs.

        Raises:
            ValueError: If the prior is not the problem's, or there is no run.
        """
        if prior is not self.problem.prior:
            raise ValueError("this prior is not the problem's: build the estimator for it")
        runs, beams = count_runs(rngs), len(self.problem.sensor.bearings)
        mean, covariance, _ = self._answers(np.zeros((1, 0, beams)), self._rules)
        stacked = Estimate(np.repeat(mean, runs, axis=0), np.repeat(covariance, runs, axis=0), np.zeros(runs))
        return ExactBelief(np.empty((runs, 0, beams)), stacked)

    def predict(self, belief: ExactBelief, control: Array, rngs: Sequence[Generator]) -> ExactBelief:
        """The same belief: the object stays where it is."""
        return belief

    def update(self, belief: ExactBelief, measurement: Array, rngs: Sequence[Generator]) -> ExactBelief:
        """Bayes' rule for a measurement (M, B); NaN = beam not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or does not hold real numbers.
        """
        runs = len(belief.readings)
        measurement = check_measurement(self.problem.sensor, measurement, runs)
        readings = np.concatenate([belief.readings, measurement[:, None]], axis=1)
        mean, covariance, log_evidence = (np.array(part) for part in belief.estimate)
        asked = np.flatnonzero((log_evidence > -np.inf) & ~np.isnan(measurement).all(axis=1))
        new_mean, new_covariance, log_evidence[asked] = self._answers(readings[asked], self._rules)
        possible = log_evidence[asked] > -np.inf
        mean[asked[possible]], covariance[asked[possible]] = new_mean[possible], new_covariance[possible]
        return ExactBelief(readings, Estimate(mean, covariance, log_evidence))

    def estimate(self, belief: ExactBelief) -> Estimate:
        """Posterior mean (M, 2), conditional covariance (M, 2, 2) and log evidence (M,)."""
        return belief.estimate

    def error(self, belief: ExactBelief) -> Array:
        """How far mean and covariance may be off, in posterior deviations, (M,): see `CanEstimateError`.

        What rules with other nodes have otherwise, and what rounding, tables and parts left out may leave.
        """
        least = ROUNDING_ERROR if self.problem.sensor.gaussian_stds is not None else OTHER_ERROR
        mean, covariance, log_evidence = belief.estimate
        errors = np.zeros(len(mean))
        some = np.flatnonzero(np.asarray(log_evidence) > -np.inf)
        again, spread, _ = self._answers(belief.readings[some], self._rules_with(MORE_NODES))
        std = np.sqrt(np.diagonal(covariance[some], axis1=1, axis2=2))
        off = (np.abs(again - mean[some]) / std).max(axis=1)
        scales = std[:, :, None] * std[:, None, :]
        errors[some] = least + np.maximum(off, (np.abs(spread - covariance[some]) / scales).max(axis=(1, 2)))
        answers = again, spread, np.asarray(log_evidence)[some]
        if self._ends is not None:
            reached = self._beyond if self._wider is None else self._out_of_reach
            errors[some[reached(belief.readings[some], answers)]] = np.inf
        return errors

    def sample(self, belief: ExactBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the posterior, (M, size, 2): from the nodes of the quadrature and the boxes about them.

        Where no place is possible any more: from the Gaussian of what was believed before.
        """
        draws = gaussian_draws(
            belief.estimate.mean, belief.estimate.covariance, size, self.problem.space, rngs
        )
        for run, rng in enumerate(rngs):
            if np.asarray(belief.estimate.log_evidence)[run] > -np.inf:
                whole = self._for(belief.readings[[run]])
                draws[run] = whole._drawn(belief.readings[run], size, rng)
        return draws

    def restricted(self, kept: Sequence[BoolArray]) -> tuple[ExactPositionFilter, float]:
        """The filter of somebody who knows besides that the place is in some of the pieces.

        Args:
            kept: For each of the `parts`, which of its pieces, (P,).

        Returns:
            A filter whose prior is this one's within those pieces, normalised, and their probability.

        Raises:
            ValueError: If the prior gives these pieces no probability.
        """
        parts = []
        for part, pieces_kept in zip(self.parts, kept, strict=True):
            every = part.pieces
            pieces = Pieces(
                every.corners[pieces_kept], every.counts[pieces_kept], every.centres[pieces_kept],
                every.log_areas[pieces_kept], every.ranges[pieces_kept], every.slopes[pieces_kept],
                every.lows[pieces_kept], every.highs[pieces_kept],
            )  # fmt: skip
            log_integral = log_integral_of(pieces, part.factor, self._rules)
            if log_integral > -np.inf:
                log_share = part.log_share + log_integral - part.log_integral
                parts.append(PriorPart(log_share, part.factor, pieces, log_integral))
        if not parts:
            raise ValueError("the prior gives these pieces no probability")
        total = float(np.logaddexp.reduce([part.log_share for part in parts]))
        other = copy(self)
        other.__dict__["parts"] = tuple(replace(part, log_share=part.log_share - total) for part in parts)
        other.__dict__["_ends"] = None
        return other, math.exp(total)

    @cached_property
    def _rules(self) -> Rules:
        return self._rules_with(0)

    @cached_property
    def _close_rules(self) -> Rules:
        """Rules whose nodes lie close together everywhere, for draws from the boxes about them."""
        return rules(NODES_OF_DRAWS)._replace(closed=False)

    def _rules_with(self, more: int) -> Rules:
        gaussian = self.problem.sensor.gaussian_stds is not None
        return rules(NODES_OF_RULES if gaussian else NODES_WHERE_SMOOTH, more)

    def _answers(self, readings: Array, rule: Rules) -> tuple[Array, Array, Array]:
        """Means (M, 2), covariances (M, 2, 2) and log evidences (M,) for readings (M, T, B) of M runs."""
        answers = self._within(readings, rule)
        beyond = self._beyond(readings, answers)
        if beyond.any() and self._wider is not None:
            for mine, theirs in zip(answers, self._wider._within(readings[beyond], rule), strict=True):
                mine[beyond] = theirs
        return answers

    def _beyond(self, readings: Array, answers: tuple[Array, Array, Array]) -> BoolArray:
        """Which runs may lie where the pieces end though a Gaussian prior does not, (M,).

        Those whose posterior leans on such an end, and those whose readings (M, T, B) fit too badly within.
        """
        if self._ends is None:
            return np.zeros(len(readings), dtype=np.bool_)
        return may_lie_beyond(self.problem.sensor, self.problem.prior, self._ends, readings, answers)

    def _out_of_reach(self, readings: Array, answers: tuple[Array, Array, Array]) -> BoolArray:
        """Which runs may lie beyond the wider pieces, too, (M,)."""
        return out_of_reach(self.problem.sensor, self.problem.prior, readings, answers)

    @cached_property
    def _ends(self) -> Ends | None:
        """Where pieces end though the prior does not."""
        return open_ends(self.problem.prior)

    @cached_property
    def _wider(self) -> ExactPositionFilter | None:
        """The same filter with pieces that reach farther; None where they are too many."""
        other = copy(self)
        other.__dict__.pop("_tables", None)
        other.__dict__["_ends"] = None
        try:
            other.__dict__["parts"] = parts_of(self.problem, self._rules, self.most_pieces, FAR_REACH)
        except ValueError:
            return None
        return other

    def _for(self, readings: Array) -> ExactPositionFilter:
        """The filter whose pieces hold the posterior of one run's readings, (1, T, B)."""
        if self._ends is None or not self._beyond(readings, self._within(readings, self._rules)).any():
            return self
        return self._wider or self

    def _within(self, readings: Array, rule: Rules) -> tuple[Array, Array, Array]:
        """What `_answers` gives, of the places within the pieces alone."""
        runs, parts = len(readings), len(self.parts)
        means, covariances = np.zeros((parts, runs, 2)), np.tile(np.eye(2), (parts, runs, 1, 1))
        logs = np.empty((parts, runs))
        stds, nothing = self.problem.sensor.gaussian_stds, nodes_for(0)
        if stds is not None:
            told, weights, common = weighed(readings, stds)
            for place, part in enumerate(self.parts):
                work = VALUES_TO_A_PIECE * told.size * len(part.pieces.counts)
                out = means[place], covariances[place], logs[place]
                in_threads(moments, runs, work, part.pieces, told, weights, part.factor, rule, nothing, *out)
            logs += common
        else:
            at_once = max(1, BEAMS_AT_ONCE // readings.shape[2]) if readings.shape[1] == 1 else 1
            for first in range(0, runs, at_once):
                tables = self._tables.of(readings[first : first + at_once])
                block = slice(first, first + len(tables.counts))
                for place, part in enumerate(self.parts):
                    out = means[place, block], covariances[place, block], logs[place, block]
                    moments_of_any(part.pieces, tables, part.factor, rule, nothing, *out)
        logs += np.array([part.log_share - part.log_integral for part in self.parts])[:, None]
        if parts == 1:
            return means[0], covariances[0], logs[0]
        best = logs.max(axis=0)
        shares = np.exp(logs - np.where(np.isneginf(best), 0.0, best))
        total = shares.sum(axis=0)
        shares[0, total == 0] = 1.0  # impossible: what the first says
        shares /= shares.sum(axis=0)
        mean = np.einsum("pm,pmi->mi", shares, means)
        away = means - mean
        covariance = np.einsum("pm,pmij->mij", shares, covariances + away[..., :, None] * away[..., None, :])
        with np.errstate(divide="ignore"):
            return mean, covariance, best + np.log(total)

    @cached_property
    def _tables(self) -> ReadingTables:
        """Makes tables of readings for ranges up to the farthest from any piece."""
        highs = [part.pieces.highs[np.isfinite(part.pieces.highs)] for part in self.parts]
        return ReadingTables(self.problem.sensor, float(max(high.max(initial=0.0) for high in highs)))

    def _drawn(self, readings: Array, size: int, rng: Generator) -> Array:
        nodes = self._noted(readings[None], ROOM)
        if nodes.total[0] > ROOM:
            nodes = self._noted(readings[None], int(nodes.total[0]))
        count = int(nodes.total[0])
        weights = np.exp(nodes.log_weights[:count] - nodes.log_weights[:count].max())
        chosen = rng.choice(count, size=size, p=weights / weights.sum())
        places, turns, share = nodes.places[chosen], nodes.turns[chosen], rng.random((size, 2))
        s = places[:, 2] + share[:, 0] * (places[:, 3] - places[:, 2])
        t = places[:, 4] + share[:, 1] * (places[:, 5] - places[:, 4])
        return places[:, :2] + np.stack(
            [turns[:, 0] * s - turns[:, 1] * t, turns[:, 1] * s + turns[:, 0] * t], axis=1
        )

    def _noted(self, readings: Array, room: int) -> Nodes:
        """The nodes of one run's readings (1, T, B) in all parts of the prior, as far as there is room."""
        nodes, stds = nodes_for(room), self.problem.sensor.gaussian_stds
        rest = self._close_rules, nodes, np.empty((1, 2)), np.empty((1, 2, 2)), np.empty(1)
        if stds is None:
            tables = self._tables.of(readings)
        else:
            told, weights, _ = weighed(readings, stds)
        for part in self.parts:
            first = int(nodes.total[0])
            if stds is None:
                moments_of_any(part.pieces, tables, part.factor, *rest)
            else:
                moments(0, 1, part.pieces, told, weights, part.factor, *rest)
            nodes.log_weights[first : int(nodes.total[0])] += part.log_share - part.log_integral
        return nodes
