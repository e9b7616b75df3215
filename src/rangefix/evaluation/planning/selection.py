"""Which beams to measure: greedy, exchange or exhaustive search, or each chosen after the reading before it.

What the first beam is expected to bring is worked out without draws. From the second beam on the readings
before it are drawn for truths from the prior, the same ones for all candidates, and the last beam's reading
is integrated exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from math import comb
from typing import Literal, get_args

import numpy as np
from numpy.random import Generator

from ...arrays import Array, IntArray
from ...filters import Problem, Rangefinder
from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.models.rangefinder import some_beams
from ...filters.refined_cells.coarse_cells import CoarseCells
from ..seeds import stream
from .candidates import candidates_near, coarse_candidates
from .cells import (
    Cells,
    beams_alike,
    cells_of,
    check_plannable,
    coarse_cells,
    posterior_cells,
    prior_cells,
    turned,
)
from .expected_covariance import Criterion, ExpectedAccuracy, expected_covariance
from .one_beam import noise_width
from .plans import Plan, Step
from .reading_table import SharedTables
from .whole_sets import covariances_after, criterion_of, truths_of

Method = Literal["greedy", "exchange", "exhaustive"]
METHODS: tuple[str, ...] = get_args(Method)
FIRST_TRUTHS = 16  # with which many candidates are compared, and by which more are added
FINE_PLACES = 12  # of them, about which all are
SECTORS, FINALISTS = 40, 20  # whose best candidates, and how many of these, meet more truths: for rare modes
CLEARLY = 3.0  # standard errors of the difference on the same truths
WORTH = 0.002  # of the criterion: a difference that does not matter
FEW_CELLS, FINE_CANDIDATES = 3000, 60  # of a prior, for all candidates; the best of these by usual cells
PICTURED = 8  # truths over which the objective of all candidates is averaged, for pictures
PASSES = 3  # of exchange over all beams
MOST_SETS = 2000  # of beams, in an exhaustive search
FINAL_SETS = 10  # the best of them, which are compared by many truths
MERGED = 1.0  # of the noise: cells of a posterior are not finer than that
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Planner:
    """Chooses beams for a problem.

    Args:
        problem: Of an object that stays where it is; only its prior, map and sensor count.
        candidates: Bearings that may be chosen, rad, (D,).
        criterion: What is made as small as possible, or as large for information.
        truths: Draws from the prior over which it is averaged while beams are looked for, from the second on.
            What is found is compared, and its accuracy told, over more where `covariances_after` can.
        seed: Of the draws.
        tell: Told what is being done.

    Raises:
        ValueError: If measurements cannot be planned for the problem, or a candidate is blind.
    """

    problem: Problem
    candidates: Array
    criterion: Criterion = "trace"
    truths: int = 64
    seed: int = 0
    tell: Tell = field(default=lambda text: None)

    def __post_init__(self) -> None:
        if not len(self.candidates) or not np.isfinite(self.candidates).all():
            raise ValueError("a plan needs candidates: finite bearings")
        if self.sensor.blind.any():
            blind = np.rad2deg(self.candidates[self.sensor.blind][0])
            raise ValueError(f"candidate {blind:g} deg lies in the blind sector: it is never measured")

    @cached_property
    def sensor(self) -> Rangefinder:
        """The rangefinder with a beam towards each candidate."""
        return turned(check_plannable(self.problem), self.candidates)

    @cached_property
    def prior(self) -> Cells:
        """What is believed before the first beam."""
        return prior_cells(self.problem)

    @cached_property
    def _pitch(self) -> Array:
        """Cells of a posterior are no finer, m and rad, (n,)."""
        lower, upper = self.problem.sensor.room.bounds
        reach = float(np.hypot(*(upper - lower)))
        beams = [0] if beams_alike(self.sensor) else range(len(self.candidates))
        noises = [noise_of_beams(self.sensor.noise, beam, len(self.candidates)) for beam in beams]
        pitch = MERGED * min(noise_width(noise, 0.0, reach) for noise in noises)
        return np.where(self.problem.space.is_angle, pitch / (0.25 * reach), pitch)

    def plan(
        self, beams: int, method: Method = "exchange", adaptive: bool = False, everywhere: bool = True
    ) -> Plan:
        """Choose so many beams.

        Args:
            beams: How many.
            method: greedy, one after the other; exchange, which then tries to better each in turn; or
                exhaustive, all sets of candidates.
            adaptive: Whether each is chosen after the readings before it are known; then by itself.
            everywhere: Whether the objective is worked out for all candidates, for pictures.

        Raises:
            ValueError: If there are fewer candidates, or too many sets of them for an exhaustive search.
        """
        if method not in METHODS:
            raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
        if not 1 <= beams <= len(self.candidates):
            raise ValueError(
                f"a plan has 1 to {len(self.candidates)} beams, as there are candidates: {beams}"
            )
        if adaptive:
            return Plan(self.candidates, self.criterion, "adaptive", True, tuple(self._adaptive(beams)))
        chosen = self._exhaustive(beams) if method == "exhaustive" else self._greedy(beams)
        if method == "exchange" and beams > 1:
            chosen = self._exchange(chosen)
        return Plan(self.candidates, self.criterion, method, False, tuple(self.steps_of(chosen, everywhere)))

    def steps_of(self, chosen: Sequence[int], everywhere: bool = True) -> list[Step]:
        """What is expected after each of some candidates, in their order.

        Args:
            chosen: Their places among the candidates.
            everywhere: Whether the objective is worked out for all candidates, for pictures.
        """
        steps = []
        for count, last in enumerate(chosen):
            self.tell(f"what is expected after beam {count + 1} of {len(chosen)}")
            objective = np.full(len(self.candidates), np.nan)
            if count == 0:
                objective = self.first_objective.copy()
                found = self._after(self.prior, [last])
                covariance, values = found.covariance[0], found.objective(self.criterion)
                objective[last] = values[0]
            else:
                purpose = f"accuracy {count}"
                truths = self.truths * (2 if count == len(chosen) - 1 else 1)
                covariance, values = self._accuracy(chosen[: count + 1], truths, purpose)
                if everywhere:
                    some = self._beliefs(chosen[:count], 0, PICTURED, purpose)
                    objective = np.mean([self._objective(belief) for belief in some], axis=0)
            error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
            bearing = float(self.candidates[last])
            steps.append(Step(bearing, covariance, self._shown(float(values.mean())), error, objective))
        return steps

    def _accuracy(self, chosen: Sequence[int], truths: int, purpose: str) -> tuple[Array, Array]:
        """E[P] after two or more candidates, and the criterion for each of so many truths, or `truths_of`."""
        found = self._after_all(chosen, purpose)
        if found is not None:
            return found.mean(axis=0), criterion_of(found, self.criterion)
        beliefs = self._beliefs(chosen[:-1], 0, truths, purpose)
        results = [self._after(belief, [chosen[-1]]) for belief in beliefs]
        covariance = np.mean([each.covariance[0] for each in results], axis=0)
        return covariance, np.array([each.objective(self.criterion)[0] for each in results])

    def _after_all(self, chosen: Sequence[int], purpose: str) -> Array | None:
        """P after some candidates for many truths, the same for a purpose: see `covariances_after`."""
        if self.criterion == "information":
            return None
        states = self.problem.prior.sample(truths_of(self.problem), stream(self.seed, f"plan {purpose}", 0))
        problem = replace(self.problem, sensor=some_beams(self.sensor, np.asarray(chosen)))
        readings = [self._read(states, beam, purpose) for beam in chosen]
        return covariances_after(problem, np.stack(readings, axis=1))

    def _mean_after(self, chosen: Sequence[int]) -> float | None:
        """The criterion after a set of candidates, over truths by which all sets are compared."""
        known, key = self._means_known, frozenset(chosen)
        if key not in known:
            found = self._after_all(sorted(chosen), "sets")
            known[key] = None if found is None else float(criterion_of(found, self.criterion).mean())
        return known[key]

    @cached_property
    def _means_known(self) -> dict[frozenset[int], float | None]:
        """What `_mean_after` has found."""
        return {}

    def _is_better(self, others: Sequence[int], other: int, instead: int, purpose: str) -> bool:
        """Whether one candidate is better beside others than another, on fresh truths."""
        beliefs = self._beliefs(others, 0, self.truths, purpose)
        pairs = np.array([self._objective(belief, [other, instead]) for belief in beliefs])
        return bool(pairs[:, 0].mean() < pairs[:, 1].mean())

    def _shown(self, value: float) -> float:
        return -value if self.criterion == "information" else value

    @cached_property
    def first_objective(self) -> Array:
        """The criterion after each candidate as the only beam, (D,): of the best ones by fine cells."""
        few = prior_cells(self.problem, FEW_CELLS)
        found = expected_covariance(few, self.sensor, self._second).objective(self.criterion)
        best = np.argsort(found)[:FINE_CANDIDATES]
        found[best] = self._objective(self.prior, best.tolist())
        return found

    @property
    def _second(self) -> bool:
        return self.criterion in ("det", "largest")

    @cached_property
    def _tables(self) -> SharedTables:
        return SharedTables()

    def _after(self, belief: Cells, beams: Sequence[int] | None = None) -> ExpectedAccuracy:
        """What some candidates, or all, bring to a belief."""
        sensor = self.sensor if beams is None else some_beams(self.sensor, np.asarray(beams))
        return expected_covariance(belief, sensor, self._second, self._tables)

    def _objective(self, belief: Cells, beams: Sequence[int] | None = None) -> Array:
        return self._after(belief, beams).objective(self.criterion)

    def _summed(self, beliefs: Sequence[Cells], beams: Sequence[int]) -> Array:
        """The objective of some candidates, summed over beliefs."""
        return np.asarray(np.sum([self._objective(belief, beams) for belief in beliefs], axis=0))

    def _beliefs(self, chosen: Sequence[int], first: int, end: int, purpose: str) -> list[Cells]:
        """What is believed after some beams, of truths `first` to `end` - 1, the same for a purpose."""
        states = self.problem.prior.sample(end, stream(self.seed, f"plan {purpose}", 0))
        problem = replace(self.problem, sensor=some_beams(self.sensor, np.asarray(chosen)))
        readings = [self._read(states, beam, purpose) for beam in chosen]
        return posterior_cells(problem, np.stack(readings, axis=1)[first:], self._pitch)

    def _read(self, states: Array, beam: int, purpose: str) -> Array:
        """Readings of a candidate at some states, m, (M,): the same whatever other beams are read."""
        rng = stream(self.seed, f"plan {purpose} {beam}", 0)
        return np.asarray(some_beams(self.sensor, np.array([beam])).sample(states, rng)[:, 0])

    @cached_property
    def _best_known(self) -> dict[frozenset[int], int]:
        """What `_best` has found, by the beams that were chosen before."""
        return {}

    def _best(self, chosen: Sequence[int], instead: int | None = None) -> int:
        """The candidate that brings most beside others, or one that brings hardly less.

        Some candidates, and then those about the best of these, on a few truths; of the best of each sector
        those that are not clearly worse on more. The truths are the same whatever is chosen.

        Args:
            chosen: The others.
            instead: What is taken unless another is better by more than WORTH.
        """
        known, key = self._best_known, frozenset(chosen)
        if key not in known:
            count, first = len(self.candidates), min(FIRST_TRUTHS, self.truths)
            beliefs = self._beliefs(chosen, 0, first, "choice")
            found, coarse = np.full(count, np.inf), coarse_candidates(count)
            found[coarse] = self._summed(beliefs, coarse.tolist())
            if len(coarse) < count:
                near = candidates_near(coarse, found[coarse], FINE_PLACES, count)
                found[near] = self._summed(beliefs, near.tolist())
            found[list(chosen)] = np.inf
            sectors = np.array_split(np.arange(count), min(SECTORS, count))
            short = np.array([sector[np.argmin(found[sector])] for sector in sectors])
            short = short[np.isfinite(found[short])]
            short = short[np.argsort(found[short])[:FINALISTS]]
            if instead is not None and instead not in short:
                short = np.append(short, instead)
            known[key] = self._race(chosen, beliefs, short, instead)
        return known[key]

    def _race(
        self, chosen: Sequence[int], beliefs: list[Cells], finalists: IntArray, instead: int | None
    ) -> int:
        """The best of some candidates; ever more truths decide between those that are not clearly worse."""
        values = np.array([self._objective(belief, finalists.tolist()) for belief in beliefs])
        while len(values) < self.truths:
            best = int(values.mean(axis=0).argmin())
            behind = values - values[:, [best]]
            sure = behind.std(axis=0, ddof=1) / np.sqrt(len(values))
            slack = WORTH * abs(values[:, best].mean())
            left = behind.mean(axis=0) <= CLEARLY * sure + slack
            left |= finalists == (-1 if instead is None else instead)
            finalists, values = finalists[left], values[:, left]
            if left.sum() == 1 or (behind.mean(axis=0) + CLEARLY * sure <= slack)[left].all():
                break
            end = min(len(values) + FIRST_TRUTHS, self.truths)
            more = self._beliefs(chosen, len(values), end, "choice")
            found = [self._objective(belief, finalists.tolist()) for belief in more]
            values = np.concatenate([values, found])
        means = values.mean(axis=0)
        best = int(means.argmin())
        if instead in finalists:
            own = int(np.flatnonzero(finalists == instead)[0])
            best = own if means[own] <= means[best] + WORTH * abs(means[best]) else best
        return int(finalists[best])

    def _greedy(self, beams: int) -> list[int]:
        chosen: list[int] = []
        for count in range(beams):
            self.tell(f"choosing beam {count + 1} of {beams}")
            if count == 0:
                chosen.append(int(np.argmin(self.first_objective)))
            else:
                chosen.append(self._best(chosen))
        return chosen

    def _exchange(self, chosen: list[int]) -> list[int]:
        """Put another candidate in the place of each beam in turn, where that is better on fresh truths.

        Of all sets on the way that counts which is best over many truths, where they can be asked: what is
        better over few may leave two places open now and then.
        """
        best, least = chosen, self._mean_after(chosen)
        for turn in range(PASSES):
            before = list(chosen)
            for place in range(len(chosen)):
                self.tell(f"exchange {turn + 1}: beam {place + 1} of {len(chosen)}")
                others = chosen[:place] + chosen[place + 1 :]
                other = self._best(others, chosen[place])
                if other == chosen[place]:
                    continue
                if self._is_better(others, other, chosen[place], f"check {turn} {place}"):
                    chosen = [*others[:place], other, *others[place:]]
                    mean = self._mean_after(chosen)
                    if mean is None or least is None or mean < least:
                        best, least = chosen, mean
            if chosen == before:
                break
        return self._ordered(best)

    def _ordered(self, chosen: list[int]) -> list[int]:
        """A set of beams in the order in which each brings most."""
        first = min(chosen, key=lambda each: float(self.first_objective[each]))
        ordered, left = [first], [each for each in chosen if each != first]
        while len(left) > 1:
            beliefs = self._beliefs(ordered, 0, FIRST_TRUTHS, "order")
            brought = np.mean([self._objective(belief, left) for belief in beliefs], axis=0)
            ordered.append(left.pop(int(np.argmin(brought))))
        return ordered + left

    def _exhaustive(self, beams: int) -> list[int]:
        count = len(self.candidates)
        if comb(count, beams) > MOST_SETS:
            raise ValueError(
                f"{comb(count, beams)} sets of {beams} beams of {count} candidates are more than {MOST_SETS}:"
                " name fewer candidates, or choose by exchange"
            )
        if beams == 1:
            return self._greedy(1)
        tried: list[tuple[float, list[int]]] = []
        for others in combinations(range(count - 1), beams - 1):
            self.tell(f"sets with candidates {', '.join(str(each + 1) for each in others)}")
            last = list(range(others[-1] + 1, count))
            beliefs = self._beliefs(others, 0, self.truths, "choice")
            values = np.mean([self._objective(belief, last) for belief in beliefs], axis=0)
            tried += [(float(value), [*others, each]) for value, each in zip(values, last, strict=True)]
        best = [chosen for _, chosen in sorted(tried)[:FINAL_SETS]]
        means = [self._mean_after(chosen) for chosen in best]
        first = int(np.argmin([np.inf if mean is None else mean for mean in means]))
        return self._ordered(best[first])

    def _adaptive(self, beams: int) -> list[Step]:
        """Each beam chosen after the readings before it, in runs whose truths are drawn from the prior."""
        first = self._greedy(1)
        steps = self.steps_of(first)
        rng = stream(self.seed, "plan adaptive", 0)
        states = self.problem.prior.sample(self.truths, rng)
        chosen = [list(first) for _ in states]
        readings = [self._read_at(state, first[0], rng) for state in states]
        beliefs: list[Cells | None] = [None] * len(states)
        for count in range(1, beams):
            self.tell(f"choosing beam {count + 1} of {beams}, after the readings before it")
            covariances, values, shown = [], [], np.zeros(len(self.candidates))
            for place, (state, mine) in enumerate(zip(states, chosen, strict=True)):
                beliefs[place] = belief = self.belief_after(mine, readings[place], beliefs[place])
                best, covariance, objective = self.next_beam(belief)
                covariances.append(covariance)
                values.append(float(objective[best]))
                shown += objective / len(states)
                mine.append(best)
                readings[place] = np.append(readings[place], self._read_at(state, best, rng))
            error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
            value = self._shown(float(np.mean(values)))
            steps.append(Step(None, np.mean(covariances, axis=0), value, error, shown))
        return steps

    def belief_after(self, chosen: Sequence[int], readings: Array, before: Cells | None = None) -> Cells:
        """What is believed after readings of some candidates.

        Args:
            chosen: Their places among the candidates, b of them; one may stand several times.
            readings: m, (b,).
            before: What was believed after the earlier ones of them: places that it rules out are not looked
                at again, which saves most of the work, unless the readings are possible nowhere else. Where
                no cell of the prior explains them either, for they are possible on a strip that cells miss,
                it stays, as a filter's belief does; that is told.

        Raises:
            ValueError: If no cell explains the readings, and nothing was believed before.
        """
        problem = replace(self.problem, sensor=some_beams(self.sensor, np.asarray(chosen)))
        key = tuple(chosen)
        if before is not None:
            coarse = coarse_cells(problem, before)
        elif key in self._covered:
            coarse = self._covered[key]
        else:
            coarse = coarse_cells(problem)
            self._covered.clear()
            self._covered[key] = coarse
        [belief] = cells_of(problem, coarse, np.asarray(readings)[None], self._pitch)
        if belief is not None:
            return belief
        if before is None:
            raise ValueError("no place explains the readings")
        try:
            return self.belief_after(chosen, readings)
        except ValueError:
            self.tell("readings that no cell explains: what was believed before the last one is kept")
            return before

    @cached_property
    def _covered(self) -> dict[tuple[int, ...], CoarseCells]:
        """The coarse cells of the beams that `belief_after` was asked for last."""
        return {}

    def next_beam(self, belief: Cells) -> tuple[int, Array, Array]:
        """The candidate that brings most to a belief.

        Returns:
            Its place among the candidates, E[P] after it, (n, n), and the objective, (D,): of candidates that
            were not looked at, for others nearby brought less, what lies between those about them.
        """
        count = len(self.candidates)
        coarse = coarse_candidates(count)
        found = self._after(belief, coarse.tolist())
        objective, looked_at = found.objective(self.criterion), coarse
        covariances = found.covariance
        if len(coarse) < count:
            near = candidates_near(coarse, objective, FINE_PLACES // 4, count)
            more = self._after(belief, near.tolist())
            looked_at = np.concatenate([coarse, near])
            objective = np.concatenate([objective, more.objective(self.criterion)])
            covariances = np.concatenate([covariances, more.covariance])
        best, order = int(np.argmin(objective)), np.argsort(looked_at)
        between = np.interp(np.arange(count), looked_at[order], objective[order])
        return int(looked_at[best]), covariances[best], between

    def _read_at(self, state: Array, beam: int, rng: Generator) -> Array:
        """A reading of a candidate at a state, m, (1,)."""
        return np.asarray(some_beams(self.sensor, np.array([beam])).sample(state, rng))
