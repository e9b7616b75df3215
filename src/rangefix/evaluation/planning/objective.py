"""What beams are chosen by: a criterion after them, expected of a belief or averaged over drawn truths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...arrays import Array
from ...filters import Problem, Rangefinder
from ...filters.exact import ExactPositionFilter
from ...filters.models.rangefinder import some_beams
from ..seeds import stream
from .cells import Cells, check_plannable, noise_widths, posterior_cells, prior_cells, turned
from .expected_covariance import Criterion, ExpectedAccuracy, expected_covariance
from .reading_table import SharedTables
from .whole_sets.covariances import TRUTHS, Accuracy, covariances_after, criterion_of, exact_filter, truths_of
from .whole_sets.look_alike_truths import LOOKED_AT, look_alike_truths
from .whole_sets.rough_accuracy import RoughAccuracy

FEW_CELLS, FINE_CANDIDATES = 3000, 60  # of a prior, for all candidates; the best of these by usual cells
SCREENED_BY, SCREENED_OF, SURELY = 0.2, 10_000, 4.0  # truths by which a set is out, from how many; its errors
PARTS = 4  # of many truths, after each of which a set of beams may be worse than another whatever follows
MERGED = 1.0  # of the noise: cells of a posterior are not finer than that


@dataclass(frozen=True)
class Objective:
    """What is made as small as possible, worked out for candidates by their places among all.

    Args:
        problem: Of an object that stays where it is; only its prior, map and sensor count.
        candidates: Bearings that may be chosen, rad, (D,).
        criterion: Of the expected accuracy; information, which is to be large, by its negative.
        truths: Draws from the prior over which it is averaged while beams are looked for, from the second on.
        seed: Of the draws. They are the same for a purpose, whatever is compared.
    """

    problem: Problem
    candidates: Array
    criterion: Criterion
    truths: int
    seed: int

    @cached_property
    def sensor(self) -> Rangefinder:
        """The rangefinder with a beam towards each candidate."""
        return turned(check_plannable(self.problem), self.candidates)

    @cached_property
    def prior(self) -> Cells:
        """What is believed before the first beam."""
        return prior_cells(self.problem)

    @cached_property
    def pitch(self) -> Array:
        """Cells of a posterior are no finer, m and rad, (n,)."""
        lower, upper = self.problem.sensor.room.bounds
        reach = float(np.hypot(*(upper - lower)))
        pitch = MERGED * float(noise_widths(self.sensor).min())
        return np.where(self.problem.space.is_angle, pitch / (0.25 * reach), pitch)

    @cached_property
    def first(self) -> Array:
        """The criterion after each candidate as the only beam, (D,): of the best ones by fine cells."""
        few = prior_cells(self.problem, FEW_CELLS)
        found = expected_covariance(few, self.sensor, self._needs_second).objective(self.criterion)
        best = np.argsort(found)[:FINE_CANDIDATES]
        found[best] = self.values(self.prior, best.tolist())
        return found

    def expected(self, belief: Cells, beams: Sequence[int] | None = None) -> ExpectedAccuracy:
        """What some candidates, or all, bring to a belief."""
        sensor = self.sensor if beams is None else some_beams(self.sensor, np.asarray(beams))
        return expected_covariance(belief, sensor, self._needs_second, self._tables)

    def values(self, belief: Cells, beams: Sequence[int] | None = None) -> Array:
        """The objective of some candidates, or of all, for a belief."""
        return self.expected(belief, beams).objective(self.criterion)

    def summed(self, beliefs: Sequence[Cells], beams: Sequence[int]) -> Array:
        """The objective of some candidates, summed over beliefs."""
        return np.asarray(np.sum([self.values(belief, beams) for belief in beliefs], axis=0))

    @property
    def adds_up(self) -> bool:
        """Whether the criterion is of the last beam alone, and of a set the sum over its beams.

        Information is, by the chain rule; of a covariance what is left after all beams counts.
        """
        return self.criterion == "information"

    @property
    def _needs_second(self) -> bool:
        return self.criterion in ("det", "largest")

    @cached_property
    def _tables(self) -> SharedTables:
        return SharedTables()

    def problem_with(self, chosen: Sequence[int]) -> Problem:
        """The problem with some candidates as its beams."""
        return replace(self.problem, sensor=some_beams(self.sensor, np.asarray(chosen)))

    def beliefs(self, chosen: Sequence[int], first: int, end: int, purpose: str) -> list[Cells]:
        """What is believed after some beams, of truths `first` to `end` - 1, the same for a purpose."""
        readings = self._readings(chosen, end, purpose)[first:]
        return posterior_cells(self.problem_with(chosen), readings, self.pitch)

    def _readings(self, chosen: Sequence[int], truths: int, purpose: str) -> Array:
        """Readings of some candidates at so many truths, m, (M, b): the same whatever others are read."""
        states = self.problem.prior.sample(truths, stream(self.seed, f"plan {purpose}", 0))
        return self._read_at(states, chosen, purpose)

    def _read_at(self, states: Array, chosen: Sequence[int], purpose: str) -> Array:
        """Readings of some candidates at states (M, n), m, (M, b)."""
        readings = []
        for beam in chosen:
            rng = stream(self.seed, f"plan {purpose} {beam}", 0)
            readings.append(some_beams(self.sensor, np.array([beam])).sample(states, rng)[:, 0])
        return np.stack(readings, axis=1)

    def accuracy(self, chosen: Sequence[int], truths: int, purpose: str) -> Accuracy:
        """What is expected after two or more candidates: over so many truths, or more by the exact filter."""
        found = self._after_all(chosen, purpose, TRUTHS)
        if found is not None:
            return found
        beliefs = self.beliefs(chosen[:-1], 0, truths, purpose)
        results = [self.expected(belief, [chosen[-1]]) for belief in beliefs]
        covariance = np.mean([each.covariance[0] for each in results], axis=0)
        values = np.array([each.objective(self.criterion)[0] for each in results])
        error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
        return Accuracy(covariance, float(values.mean()), error, len(values), len(values))

    def _after_all(
        self, chosen: Sequence[int], purpose: str, count: int, enough: float = np.inf
    ) -> Accuracy | None:
        """What is expected after some candidates over so many truths; None without an `exact_filter`.

        Where the criterion is sure to be no less than `enough`, it is not worked out further, and infinite:
        most sets are out after a few truths.
        """
        if self.criterion == "information":
            return None
        exact = exact_filter(self.problem_with(chosen))
        if exact is None:
            return None
        if enough < np.inf:
            few = self._over_truths(exact, chosen, f"few {purpose}", int(SCREENED_BY * count), SCREENED_OF)
            if few.value - SURELY * few.error >= enough:
                return few._replace(value=np.inf)
        return self._over_truths(exact, chosen, purpose, count, LOOKED_AT, enough)

    def _over_truths(
        self, exact: ExactPositionFilter, chosen: Sequence[int], purpose: str, count: int, looked_at: int,
        enough: float = np.inf,
    ) -> Accuracy:  # fmt: skip
        """What is expected after some candidates over so many truths, chosen from up to `looked_at`."""
        truths = look_alike_truths(exact, count, stream(self.seed, f"plan {purpose}", 0), looked_at)
        readings = self._read_at(truths.states, chosen, purpose)
        covariances, values, total = np.empty((count, 2, 2)), np.empty(count), 0.0
        for part in np.array_split(np.arange(count), 1 if enough == np.inf else PARTS):
            covariances[part] = covariances_after(exact, readings[part])
            values[part] = criterion_of(covariances[part], self.criterion)
            total += float(truths.weights[part] @ values[part])
            if total >= enough * count:
                return Accuracy(np.full((2, 2), np.inf), np.inf, np.inf, count, truths.looked_at)
        value, error = truths.mean(values)
        covariance = np.mean(truths.weights[:, None, None] * covariances, axis=0)
        return Accuracy(covariance, value, error, count, truths.looked_at)

    @property
    def compares_sets(self) -> bool:
        """Whether sets of beams can be compared over many truths: `mean_after` tells of them."""
        return self.criterion != "information" and exact_filter(self.problem_with([0])) is not None

    def mean_after(self, chosen: Sequence[int], enough: float = np.inf) -> float | None:
        """The criterion after a set of candidates, over truths by which all sets are compared.

        Args:
            chosen: Their places.
            enough: Where it is sure to be no less, it is not worked out further: infinity is told.
        """
        known, key = self._means_known, frozenset(chosen)
        if key not in known:
            found = self._after_all(sorted(chosen), "sets", truths_of(self.problem), enough)
            if found is not None and found.value == np.inf:
                return found.value
            known[key] = None if found is None else found.value
        return known[key]

    @cached_property
    def _means_known(self) -> dict[frozenset[int], float | None]:
        """What `mean_after` has found."""
        return {}

    def rough(self, places: Sequence[int], truths: int) -> RoughAccuracy:
        """What some candidates tell roughly, many sets of them in a second; the heading is known."""
        rng = stream(self.seed, f"plan rough {truths}", 0)
        return RoughAccuracy.of(self.problem_with(places), self.criterion, truths, rng)

    def is_better(self, others: Sequence[int], other: int, instead: int, purpose: str) -> bool:
        """Whether one candidate is better beside others than another, on fresh truths."""
        beliefs = self.beliefs(others, 0, self.truths, purpose)
        pairs = np.array([self.values(belief, [other, instead]) for belief in beliefs])
        return bool(pairs[:, 0].mean() < pairs[:, 1].mean())

    def shown(self, value: float) -> float:
        """A value as plans state it: information is made small as its negative."""
        return -value if self.criterion == "information" else value
