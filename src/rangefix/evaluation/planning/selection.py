"""Which beams to measure: greedy, exchange or exhaustive search, or each chosen after the reading before it.

What the first beam is expected to bring is worked out exactly. From the second beam on the readings before it
are drawn for truths from the prior, the same ones for all candidates, and the last beam's reading is
integrated exactly.
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

from ...arrays import Array
from ...filters import Problem, Rangefinder
from ...filters.models.noise_of_beams import noise_of_beams
from ..seeds import stream
from .cells import Cells, check_plannable, posterior_cells, prior_cells, turned
from .expected_covariance import Criterion, ExpectedAccuracy, expected_covariance, some_beams
from .one_beam import noise_width

Method = Literal["greedy", "exchange", "exhaustive"]
METHODS: tuple[str, ...] = get_args(Method)
FIRST_TRUTHS = 24  # with which all candidates are compared
SECTORS = 40  # whose best candidates are compared with all truths: rare wrong modes need many
PASSES = 2  # of exchange over all beams
MOST_SETS = 2000  # of beams, in an exhaustive search
MERGED = 1.0  # of the noise: cells of a posterior are not finer than that
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """One beam of a plan, and what is expected after it.

    Attributes:
        bearing: From the heading, rad clockwise; None where it depends on the readings before.
        covariance: E[P] after this beam and those before it, (n, n); m^2 and rad^2.
        value: The criterion after it: m^2, m^4 for det, nats of this beam for information.
        error: Standard error of the value: of the drawn truths; 0 for the first beam, which is exact.
        objective: The criterion for each candidate as it was chosen, (D,); NaN where it was not asked for.
    """

    bearing: float | None
    covariance: Array
    value: float
    error: float
    objective: Array

    @property
    def position_std(self) -> float:
        """Root of the expected square of the position's error, m."""
        return float(np.sqrt(max(self.covariance[0, 0] + self.covariance[1, 1], 0.0)))


@dataclass(frozen=True)
class Plan:
    """Beams to measure, in this order.

    Attributes:
        candidates: Bearings that were compared, rad, (D,).
        criterion, method, adaptive: How they were chosen.
        steps: One for each beam.
    """

    candidates: Array
    criterion: Criterion
    method: str
    adaptive: bool
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Planner:
    """Chooses beams for a problem.

    Args:
        problem: Of an object that stays where it is; only its prior, map and sensor count.
        candidates: Bearings that may be chosen, rad, (D,).
        criterion: What is made as small as possible, or as large for information.
        truths: Draws from the prior over which it is averaged from the second beam on.
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
        sensor = replace(check_plannable(self.problem), bearings=self.sensor.bearings)
        if not len(self.candidates) or not np.isfinite(self.candidates).all():
            raise ValueError("a plan needs candidates: finite bearings")
        if sensor.blind.any():
            blind = np.rad2deg(self.candidates[sensor.blind][0])
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
        noises = (noise_of_beams(self.sensor.noise, beam, len(self.candidates)) for beam in (0, -1))
        pitch = MERGED * min(noise_width(noise, 0.0, reach) for noise in noises)
        return np.where(self.problem.space.is_angle, pitch / (0.25 * reach), pitch)

    def plan(self, beams: int, method: Method = "exchange", adaptive: bool = False) -> Plan:
        """Choose so many beams.

        Args:
            beams: How many.
            method: greedy, one after the other; exchange, which then tries to better each in turn; or
                exhaustive, all sets of candidates.
            adaptive: Whether each is chosen after the readings before it are known; then by itself.

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
        return Plan(self.candidates, self.criterion, method, False, tuple(self.steps_of(chosen)))

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
                found = self._after_first
                objective = found.objective(self.criterion)
                covariance, values = found.covariance[last], objective[[last]]
            else:
                beliefs = self._beliefs(chosen[:count], 2 * self.truths, f"accuracy {count}")
                results = [self._after(belief, [last]) for belief in beliefs]
                covariance = np.mean([each.covariance[0] for each in results], axis=0)
                values = np.array([each.objective(self.criterion)[0] for each in results])
                if everywhere:
                    some = beliefs[: FIRST_TRUTHS // 3]
                    objective = np.mean([self._objective(belief) for belief in some], axis=0)
            error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
            bearing = float(self.candidates[last])
            steps.append(Step(bearing, covariance, self._shown(float(values.mean())), error, objective))
        return steps

    def _shown(self, value: float) -> float:
        return -value if self.criterion == "information" else value

    @cached_property
    def _after_first(self) -> ExpectedAccuracy:
        """What each candidate brings as the only beam: exact."""
        return expected_covariance(self.prior, self.sensor, self._second)

    @property
    def _second(self) -> bool:
        return self.criterion in ("det", "largest")

    def _after(self, belief: Cells, beams: Sequence[int] | None = None) -> ExpectedAccuracy:
        """What some candidates, or all, bring to a belief."""
        sensor = self.sensor if beams is None else some_beams(self.sensor, np.asarray(beams))
        return expected_covariance(belief, sensor, self._second)

    def _objective(self, belief: Cells, beams: Sequence[int] | None = None) -> Array:
        return self._after(belief, beams).objective(self.criterion)

    def _beliefs(self, chosen: Sequence[int], truths: int, purpose: str) -> list[Cells]:
        """What is believed after some beams, for truths drawn afresh for each purpose."""
        rng = stream(self.seed, f"plan {purpose}", 0)
        states = self.problem.prior.sample(truths, rng)
        problem = replace(self.problem, sensor=some_beams(self.sensor, np.asarray(chosen)))
        found = posterior_cells(problem, problem.sensor.sample(states, rng))
        return [cells.merged(self._pitch) for cells in found]

    def _best(self, chosen: Sequence[int], purpose: str) -> int:
        """The candidate that brings most: all on a few truths, then the best of each sector on more."""
        beliefs = self._beliefs(chosen, self.truths, purpose)
        few = np.sum([self._objective(belief) for belief in beliefs[:FIRST_TRUTHS]], axis=0)
        few[list(chosen)] = np.inf
        sectors = np.array_split(np.arange(len(few)), min(SECTORS, len(few)))
        short = np.array([sector[np.argmin(few[sector])] for sector in sectors])
        rest = [self._objective(belief, short.tolist()) for belief in beliefs[FIRST_TRUTHS:]]
        return int(short[np.argmin(few[short] + np.sum(rest, axis=0))])

    def _greedy(self, beams: int) -> list[int]:
        chosen: list[int] = []
        for count in range(beams):
            self.tell(f"choosing beam {count + 1} of {beams}")
            if count == 0:
                chosen.append(int(np.argmin(self._after_first.objective(self.criterion))))
            else:
                chosen.append(self._best(chosen, f"beam {count}"))
        return chosen

    def _exchange(self, chosen: list[int]) -> list[int]:
        """Put another candidate in the place of each beam in turn, where that is better on fresh truths."""
        for turn in range(PASSES):
            before = list(chosen)
            for place in range(len(chosen)):
                self.tell(f"exchange {turn + 1}: beam {place + 1} of {len(chosen)}")
                others = chosen[:place] + chosen[place + 1 :]
                other = self._best(others, f"exchange {turn} {place}")
                if other != chosen[place]:
                    beliefs = self._beliefs(others, self.truths, f"check {turn} {place}")
                    pairs = np.array([self._objective(belief, [other, chosen[place]]) for belief in beliefs])
                    if pairs[:, 0].mean() < pairs[:, 1].mean():
                        chosen = [*others[:place], other, *others[place:]]
            if chosen == before:
                break
        return self._ordered(chosen)

    def _ordered(self, chosen: list[int]) -> list[int]:
        """A set of beams in the order in which each brings most."""
        first = min(chosen, key=lambda each: float(self._after_first.objective(self.criterion)[each]))
        ordered, left = [first], [each for each in chosen if each != first]
        while len(left) > 1:
            beliefs = self._beliefs(ordered, self.truths, f"order {len(ordered)}")
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
        best, chosen = np.inf, list[int]()
        for others in combinations(range(count - 1), beams - 1):
            self.tell(f"sets with candidates {', '.join(str(each + 1) for each in others)}")
            last = list(range(others[-1] + 1, count))
            beliefs = self._beliefs(others, self.truths, "exhaustive")
            values = np.mean([self._objective(belief, last) for belief in beliefs], axis=0)
            if values.min() < best:
                best, chosen = float(values.min()), [*others, last[int(np.argmin(values))]]
        return self._ordered(chosen)

    def _adaptive(self, beams: int) -> list[Step]:
        """Each beam chosen after the readings before it, in runs whose truths are drawn from the prior."""
        first = self._greedy(1)
        steps = self.steps_of(first)
        rng = stream(self.seed, "plan adaptive", 0)
        states = self.problem.prior.sample(self.truths, rng)
        chosen = [list(first) for _ in states]
        readings = [self._read(state, first, rng) for state in states]
        for count in range(1, beams):
            self.tell(f"choosing beam {count + 1} of {beams}, after the readings before it")
            covariances, values, shown = [], [], np.zeros(len(self.candidates))
            for state, mine, read in zip(states, chosen, readings, strict=True):
                problem = replace(self.problem, sensor=some_beams(self.sensor, np.array(mine)))
                [belief] = posterior_cells(problem, np.array([read]))
                found = self._after(belief.merged(self._pitch))
                objective = found.objective(self.criterion)
                best = int(np.argmin(objective))
                covariances.append(found.covariance[best])
                values.append(float(objective[best]))
                shown += objective / len(states)
                mine.append(best)
                read.extend(self._read(state, [best], rng))
            error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
            value = self._shown(float(np.mean(values)))
            steps.append(Step(None, np.mean(covariances, axis=0), value, error, shown))
        return steps

    def _read(self, state: Array, beams: Sequence[int], rng: Generator) -> list[float]:
        """Readings of some candidates at a state, m."""
        reading: list[float] = some_beams(self.sensor, np.asarray(beams)).sample(state, rng).tolist()
        return reading
