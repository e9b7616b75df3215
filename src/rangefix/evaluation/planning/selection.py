"""Which beams to measure: a set chosen before any is read, or each beam chosen after the reading before it.

What the first beam is expected to bring is worked out without draws. From the second beam on the readings
before it are drawn for truths from the prior, the same ones for all candidates, and the last beam's reading
is integrated exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.random import Generator

from ...arrays import Array, keep_whole, whole_number
from ...filters import Problem, Rangefinder
from ...filters.models.rangefinder import some_beams
from ...filters.refined_cells.coarse_cells import CoarseCells
from ..seeds import stream
from .beam_sets import MOST_CHOICES, PASSES, BeamSets, Tell
from .candidates import candidates_near, coarse_candidates
from .cells import Cells, cells_of, coarse_cells
from .expected_covariance import Criterion
from .objective import Objective
from .plans import Plan, Step
from .time_left import TimeLeft
from .whole_sets.covariances import Accuracy

Method = Literal["greedy", "exchange", "exhaustive"]
METHODS: tuple[Method, ...] = get_args(Method)
NEXT_PLACES = 3  # of candidates for the next beam, about which all are looked at
PICTURED = 8  # truths over which the objective of all candidates is averaged, for pictures


@dataclass(frozen=True)
class Planner:
    """Chooses beams for a problem.

    Args:
        problem: Of an object that stays where it is; only its prior, map and sensor count.
        candidates: Bearings that may be chosen, rad, (D,).
        criterion: What is made as small as possible, or as large for information.
        truths: Draws from the prior over which it is averaged while beams are looked for, from the second on.
            What is found is compared, and its accuracy told, over more where `exact_filter` can. At least
            two: one tells no error.
        seed: Of the draws, a whole number from 0.
        tell: Told what is being done.

    Raises:
        ValueError: If measurements cannot be planned for the problem, a candidate is blind, or a number does
            not fit.
    """

    problem: Problem
    candidates: Array
    criterion: Criterion = "trace"
    truths: int = 64
    seed: int = 0
    tell: Tell = field(default=lambda text: None)

    def __post_init__(self) -> None:
        keep_whole(self, "truths", 2)
        keep_whole(self, "seed", 0)
        if not len(self.candidates) or not np.isfinite(self.candidates).all():
            raise ValueError("a plan needs candidates: finite bearings")
        if self.sensor.blind.any():
            blind = np.rad2deg(self.candidates[self.sensor.blind][0])
            raise ValueError(f"candidate {blind:g} deg lies in the blind sector: it is never measured")

    @cached_property
    def objective(self) -> Objective:
        """What is made as small as possible."""
        return Objective(self.problem, self.candidates, self.criterion, self.truths, self.seed)

    @cached_property
    def sets(self) -> BeamSets:
        """Sets of candidates that are chosen before any is read."""
        return BeamSets(self.objective, self.tell, self._time)

    @cached_property
    def _time(self) -> TimeLeft:
        return TimeLeft()

    @property
    def sensor(self) -> Rangefinder:
        """The rangefinder with a beam towards each candidate."""
        return self.objective.sensor

    @property
    def prior(self) -> Cells:
        """What is believed before the first beam."""
        return self.objective.prior

    def plan(
        self, beams: int, method: Method = "exchange", adaptive: bool = False, everywhere: bool = True
    ) -> Plan:
        """Choose so many beams.

        Args:
            beams: How many.
            method: greedy, one after the other; exchange, which then tries to better each in turn, and tries
                all sets where these are few; or exhaustive, all sets of candidates.
            adaptive: Whether each is chosen after the readings before it are known; then by itself.
            everywhere: Whether the objective is worked out for all candidates, for pictures.

        Raises:
            ValueError: If beams is no whole number from 1, or there are fewer candidates, or too many sets of
                them for an exhaustive search.
        """
        if method not in METHODS:
            raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
        beams = whole_number("beams", beams, 1)
        if beams > len(self.candidates):
            raise ValueError(
                f"a plan has 1 to {len(self.candidates)} beams, as there are candidates: {beams}"
            )
        if adaptive:
            return Plan(self.candidates, self.criterion, "adaptive", True, tuple(self._adaptive(beams)))
        if method == "exchange" and beams > 1 and self.sets.are_few(beams):
            method = "exhaustive"
        chosen = self._chosen(beams, method)
        return Plan(self.candidates, self.criterion, method, False, tuple(self.steps_of(chosen, everywhere)))

    def _chosen(self, beams: int, method: Method) -> list[int]:
        """So many candidates, chosen before any is read."""
        if method == "exhaustive":
            return self.sets.exhaustive(beams)
        least, most = (beams, max(MOST_CHOICES, PASSES * beams)) if method == "exchange" else (0, 0)
        self._time.begin(beams - 1 + least, beams - 1 + most)
        chosen = self.sets.greedy(beams)
        return self.sets.exchanged(chosen) if method == "exchange" and beams > 1 else chosen

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
                objective = self.objective.first.copy()
                first = self.objective.expected(self.prior, [last])
                objective[last] = first.objective(self.criterion)[0]
                found = Accuracy(first.covariance[0], float(objective[last]), 0.0, 0, 0)
            else:
                purpose = f"accuracy {count}"
                truths = self.truths * (2 if count == len(chosen) - 1 else 1)
                found = self.objective.accuracy(chosen[: count + 1], truths, purpose)
                if everywhere:
                    some = self.objective.beliefs(chosen[:count], 0, PICTURED, purpose)
                    objective = np.mean([self.objective.values(belief) for belief in some], axis=0)
            bearing, value = float(self.candidates[last]), self.objective.shown(found.value)
            step = Step(
                bearing, found.covariance, value, found.error, objective, found.truths, found.looked_at, last
            )
            steps.append(step)
        return steps

    def _adaptive(self, beams: int) -> list[Step]:
        """Each beam chosen after the readings before it, in runs whose truths are drawn from the prior."""
        first = self.sets.greedy(1)
        steps = self.steps_of(first)
        rng = stream(self.seed, "plan adaptive", 0)
        states = self.problem.prior.sample(self.truths, rng)
        chosen = [list(first) for _ in states]
        readings = [self._read_at(state, first[0], rng) for state in states]
        beliefs: list[Cells | None] = [None] * len(states)
        self._time.begin((beams - 1) * len(states), (beams - 1) * len(states))
        for count in range(1, beams):
            covariances, values, shown = [], [], np.zeros(len(self.candidates))
            for place, (state, mine) in enumerate(zip(states, chosen, strict=True)):
                run = f"truth {place + 1} of {len(states)}"
                text = f"choosing beam {count + 1} of {beams}, after the readings before it: {run}"
                self.tell(self._time.told(text))
                beliefs[place] = belief = self.belief_after(mine, readings[place], beliefs[place])
                best, covariance, objective = self.next_beam(belief)
                covariances.append(covariance)
                values.append(float(objective[best]))
                shown += objective / len(states)
                mine.append(best)
                readings[place] = np.append(readings[place], self._read_at(state, best, rng))
                self._time.made()
            error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
            value = self.objective.shown(float(np.mean(values)))
            steps.append(
                Step(None, np.mean(covariances, axis=0), value, error, shown, len(values), len(values))
            )
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
        problem = self.objective.problem_with(chosen)
        key = tuple(chosen)
        if before is not None:
            coarse = coarse_cells(problem, before)
        elif key in self._covered:
            coarse = self._covered[key]
        else:
            coarse = coarse_cells(problem)
            self._covered.clear()
            self._covered[key] = coarse
        [belief] = cells_of(problem, coarse, np.asarray(readings)[None], self.objective.pitch)
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
        found = self.objective.expected(belief, coarse.tolist())
        objective, looked_at = found.objective(self.criterion), coarse
        covariances = found.covariance
        if len(coarse) < count:
            near = candidates_near(coarse, objective, NEXT_PLACES, count)
            more = self.objective.expected(belief, near.tolist())
            looked_at = np.concatenate([coarse, near])
            objective = np.concatenate([objective, more.objective(self.criterion)])
            covariances = np.concatenate([covariances, more.covariance])
        best, order = int(np.argmin(objective)), np.argsort(looked_at)
        between = np.interp(np.arange(count), looked_at[order], objective[order])
        return int(looked_at[best]), covariances[best], between

    def _read_at(self, state: Array, beam: int, rng: Generator) -> Array:
        """A reading of a candidate at a state, m, (1,)."""
        return np.asarray(some_beams(self.sensor, np.array([beam])).sample(state, rng))
