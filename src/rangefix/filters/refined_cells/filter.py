"""The point-mass filter whose cells follow the readings: fine where a posterior is sharp or cut."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray, keep_whole
from ..estimate import BriefRepr, Estimate, brief
from ..images import image_of_points
from ..measurement import check_measurement, count_runs
from ..models.correlated import refuse_shared_errors
from ..models.motion import refuse_moving
from ..optional_methods import Image
from ..prior_ends import Ends, FarReaching, may_lie_beyond, open_ends, out_of_reach
from ..problem import Prior, Problem
from ..sampling import cell_draws, gaussian_draws
from ..space import deviations_apart, is_definite, may_lack_direction, resultant_of_cells
from .coarse_cells import CoarseCells, cover
from .likelihood import Likelihood
from .refinement import Refined, Refinement

MOST_RUNS_AT_ONCE = 16
USUAL_CELLS = 4000.0  # that follow the readings of a run; rarely ten times as many
CELLS_GB = 1.0  # of the usual cells of the runs that are worked on at once; one that takes more is refused
FLOAT, COPIES = 8, 3  # bytes, and of each cell while some are halved
SUM_ROUNDING = 1e-10  # of a covariance summed over cells
OTHER_SEED = 1  # of the places of the second lattice, by which the error is told
SAFETY = 3.0  # as grid convergence indices have it where two grids are compared (Roache, 1994)
FIRST_SEED = 0


@dataclass(frozen=True, repr=False)
class RefinedBelief:
    """A posterior as the readings that made it, and what they come down to.

    Attributes:
        readings: All measurements so far, (M, T, B), m.
        estimate: Mean, covariance and log evidence.
        error: What the cells say that mean and covariance may be off by, in deviations, (M,).
        far: Which runs the cells of `far` tell, (M,).
    """

    readings: Array
    estimate: Estimate
    error: Array
    far: BoolArray

    def __repr__(self) -> str:
        return brief(self, self.estimate)


@dataclass(frozen=True, repr=False)
class RefinedPointMassFilter(BriefRepr):
    """The exact posterior, up to an accuracy, of an object that stays where it is: cells follow the readings.

    The prior is covered once with coarse cells, and each keeps the wall that every beam meets in it. For each
    measurement those that can hold it are integrated, in boxes that are halved until none is wider than what
    the readings tell there. Cells that a jump of a range crosses are halved too, with ranges cast anew, until
    what they may err by does not matter (docs/decisions/0033-cells-that-follow-the-readings.md).

    Cells cover a Gaussian prior to 6 deviations. Readings that lead farther, or fit nowhere there, are asked
    once more of cells that cover it to 40; where those end too early, `error` is inf.

    Args:
        problem: The problem; its motion must be `Stationary`, its space x1, x2 or x1, x2, heading.
        accuracy: What mean and covariance may be off by, in standard deviations of the posterior.
        most_cells: The most cells of one run. Where they are not enough the answer is coarser, and its error
            says by how much.

    Raises:
        ValueError: If the problem is of another kind, an option is not positive, the prior allows no cell, or
            the cells of one measurement of so many beams would take more than 1 GB.
    """

    problem: Problem
    accuracy: float = 0.02
    most_cells: int = 200_000

    def __post_init__(self) -> None:
        refuse_moving(
            self.problem.motion, "the fixed-grid point-mass filter", "adaptive-point-mass or particle"
        )
        if self.problem.space.names not in (("x1", "x2"), ("x1", "x2", "heading")):
            names = ", ".join(self.problem.space.names)
            raise ValueError(
                f"without cell the point-mass filter takes x1, x2 and heading, not {names}: give cell"
            )
        refuse_shared_errors(self.problem.sensor, "the point-mass filter without cell")
        if not 0 < self.accuracy < 1:
            raise ValueError(f"accuracy must be between 0 and 1, got {self.accuracy}")
        keep_whole(self, "most_cells", 1)
        beams, most = len(self.problem.sensor.bearings), most_beams(self.problem.space.size)
        if beams > most:
            raise ValueError(
                f"the cells of one measurement of {beams} beams take about "
                f"{run_bytes(self.problem.space.size, beams) / 1e9:.2g} GB, more than {CELLS_GB:g}: "
                f"take at most {most} beams"
            )
        self.coarse  # noqa: B018 (cast before the first update, and refuses what does not fit)

    @cached_property
    def coarse(self) -> CoarseCells:
        """The coarse cells, from which those of each run are made."""
        return cover(self.problem, np.zeros(self.problem.space.size), FIRST_SEED)

    @cached_property
    def other_coarse(self) -> CoarseCells:
        """A second lattice, shifted against the first: what it answers differently is an error."""
        rng = np.random.default_rng(OTHER_SEED)
        return cover(self.problem, rng.uniform(0.2, 0.8, self.problem.space.size), OTHER_SEED)

    @cached_property
    def _ends(self) -> Ends | None:
        """Where cells end though the prior does not."""
        return open_ends(self.problem.prior)

    @cached_property
    def far(self) -> RefinedPointMassFilter | None:
        """The same filter with cells that go farther along a Gaussian prior; None where the prior ends."""
        if self._ends is None:
            return None
        return replace(self, problem=replace(self.problem, prior=FarReaching(self.problem.prior)))

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> RefinedBelief:
        """The prior, the same for all runs.

        Raises:
            ValueError: If the prior is not the problem's, or there is no run.
        """
        if prior is not self.problem.prior:
            raise ValueError("this prior is not the problem's: build the estimator for it")
        runs = count_runs(rngs)
        mean, covariance = np.tile(prior.mean, (runs, 1)), np.tile(prior.covariance, (runs, 1, 1))
        readings = np.empty((runs, 0, len(self.problem.sensor.bearings)))
        nothing = np.zeros(runs)
        return RefinedBelief(readings, Estimate(mean, covariance, nothing), nothing, np.zeros(runs, np.bool_))

    def predict(self, belief: RefinedBelief, control: Array, rngs: Sequence[Generator]) -> RefinedBelief:
        """The same belief: the object stays where it is."""
        return belief

    def update(self, belief: RefinedBelief, measurement: Array, rngs: Sequence[Generator]) -> RefinedBelief:
        """Bayes' rule for a measurement (M, B); NaN = beam not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        runs = len(belief.readings)
        measurement = check_measurement(self.problem.sensor, measurement, runs)
        readings = np.concatenate([belief.readings, measurement[:, None]], axis=1)
        mean, covariance, log_evidence = (np.array(part) for part in belief.estimate)
        error, far = belief.error.copy(), belief.far.copy()
        told = np.flatnonzero((log_evidence > -np.inf) & ~np.isnan(measurement).all(axis=1))
        at_once = runs_at_once(self.problem)
        for start in range(0, len(told), at_once):
            some = told[start : start + at_once]
            found = self._answer(self.coarse, readings[some])
            far[some] = self._lies_far(readings[some], found)
            if far[some].any() and self.far is not None:  # its cells are made where they are asked
                beyond = np.flatnonzero(far[some])
                found = found.with_runs(beyond, self.far._answer(self.far.coarse, readings[some[beyond]]))
            log_evidence[some] = found.log_integral - self.coarse.log_integral
            possible = found.log_integral > -np.inf
            kept = some[possible]
            mean[kept], covariance[kept] = found.mean[possible], found.covariance[possible]
            error[some] = np.where(possible, found.error, 0.0)
        return RefinedBelief(readings, Estimate(mean, covariance, log_evidence), error, far)

    def _lies_far(self, readings: Array, found: Refined) -> BoolArray:
        """Which runs may lie where cells end though a Gaussian prior does not, (M,)."""
        if self._ends is None:
            return np.zeros(len(readings), dtype=np.bool_)
        answers = found.mean, found.covariance, found.log_integral - self.coarse.log_integral
        return may_lie_beyond(self.problem.sensor, self.problem.prior, self._ends, readings, answers)

    def estimate(self, belief: RefinedBelief) -> Estimate:
        """Posterior mean (M, n), conditional covariance (M, n, n) and log evidence (M,)."""
        return belief.estimate

    def error(self, belief: RefinedBelief) -> Array:
        """How far mean and covariance may be off, in posterior deviations, (M,).

        The greater of what the cells say themselves (rules of fewer nodes, jumps that cross cells, cells that
        are still wide) and of the difference to what a second lattice answers, shifted against the first;
        SAFETY times that where the noise is not Gaussian, for both meet the same steps of its density. Of
        what may lie where far cells end, 40 deviations from a Gaussian prior's mean, nothing is known: inf.
        Nor is anything where headings may be so evenly spread that none is their mean: lattices agree there
        by chance.
        """
        mean, covariance, log_evidence = belief.estimate
        errors = belief.error.copy()
        for far in (False, True):
            some = np.flatnonzero((np.asarray(log_evidence) > -np.inf) & (belief.far == far))
            if not len(some):
                continue
            asked, at_once = self.far if far and self.far is not None else self, runs_at_once(self.problem)
            for start in range(0, len(some), at_once):
                part = some[start : start + at_once]
                other = asked._answer(asked.other_coarse, belief.readings[part])
                mine, theirs = (mean[part], covariance[part], None), (other.mean, other.covariance, None)
                differs = deviations_apart(self.problem.space, mine, theirs)
                differs = np.where(other.log_integral > -np.inf, differs, np.inf)
                errors[part] = np.maximum(errors[part], differs)
        some = np.flatnonzero(belief.far & (np.asarray(log_evidence) > -np.inf))
        answers = mean[some], covariance[some], np.asarray(log_evidence)[some]
        lost = out_of_reach(self.problem.sensor, self.problem.prior, belief.readings[some], answers)
        errors[some[lost]] = np.inf
        if self.problem.sensor.gaussian_stds is None:
            errors *= SAFETY
        possible = np.flatnonzero(np.asarray(log_evidence) > -np.inf)
        lacking = may_lack_direction(
            self.problem.space,
            covariance[possible],
            errors[possible],
            lambda place: self._resultant(belief, int(possible[place])),
        )
        errors[possible[lacking]] = np.inf
        return errors

    def resultant(self, belief: RefinedBelief) -> Array:
        """Length of the mean resultant vector of the heading, (M,): see `CanTellDirection`.

        1 where no place is possible any more.

        Raises:
            NotImplementedError: If the heading is known.
        """
        if self.problem.space.heading is not None:
            raise NotImplementedError("the heading is known")
        return np.array([self._resultant(belief, run) for run in range(len(belief.readings))])

    def _resultant(self, belief: RefinedBelief, run: int) -> float:
        """That of one run."""
        if np.asarray(belief.estimate.log_evidence)[run] == -np.inf:
            return 1.0
        centres, _, logs = self.boxes(belief, run)
        return resultant_of_cells(centres[:, 2], logs)

    def sample(self, belief: RefinedBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the cells, with the claimed mean and covariance, (M, size, n).

        Where no place is possible any more: from the Gaussian of what was believed before.
        """
        mean, covariance, log_evidence = belief.estimate
        space = self.problem.space
        draws = gaussian_draws(mean, covariance, size, space, rngs)
        some = np.flatnonzero(np.asarray(log_evidence) > -np.inf)
        cells = (self.boxes(belief, int(run)) for run in some)
        claim = mean[some], covariance[some]
        draws[some] = cell_draws(cells, claim, size, space, [rngs[int(run)] for run in some])
        return draws

    def density(self, belief: RefinedBelief, run: int) -> Image:
        """The probabilities of a run's cells, for pictures."""
        if np.asarray(belief.estimate.log_evidence)[run] == -np.inf:
            raise NotImplementedError("nothing is possible any more: there is no density to show")
        centres, _, logs = self.boxes(belief, run)
        return image_of_points(centres, self.problem, logs)

    def boxes(self, belief: RefinedBelief, run: int) -> tuple[Array, Array, Array]:
        """Boxes about the nodes of a run's cells: centres (N, n), widths (N, n) and log masses (N,)."""
        readings, asked = belief.readings[run : run + 1], self
        if belief.far[run] and self.far is not None:
            asked = self.far
        return next(boxes_of_each(asked.problem, asked.coarse, readings, self.accuracy, self.most_cells))

    def _answer(self, coarse: CoarseCells, readings: Array) -> Refined:
        """What cells say of some runs; claims that are flat are raised to those of places even in a cell."""
        refinement = Refinement(self.problem, coarse, self.accuracy, self.most_cells)
        found = refinement.answer(Likelihood(self.problem.sensor, readings, coarse.farthest))
        flat = (found.log_integral > -np.inf) & ~is_definite(found.covariance, SUM_ROUNDING)
        found.covariance[flat] += np.diag(coarse.steps[0] ** 2 / 12)
        return found


def boxes_of_each(
    problem: Problem, coarse: CoarseCells, readings: Array, accuracy: float, most_cells: int
) -> Iterator[tuple[Array, Array, Array]]:
    """Boxes about the nodes of the cells of each run: centres (N, n), widths (N, n) and log masses (N,).

    Args:
        problem: The problem.
        coarse: Coarse cells over its prior.
        readings: (M, T, B), m.
        accuracy, most_cells: As of the filter.
    """
    refinement, at_once = Refinement(problem, coarse, accuracy, most_cells), runs_at_once(problem)
    for start in range(0, len(readings), at_once):
        likelihood = Likelihood(problem.sensor, readings[start : start + at_once], coarse.farthest)
        found = refinement.answer(likelihood)
        for run in range(len(likelihood.readings)):
            yield refinement.boxes(likelihood.rows(np.array([run])), found.of_run(run))


def run_bytes(size: int, beams: int) -> float:
    """What the usual cells of one run take, with so many components and beams."""
    a_cell = 2 * size**2 + 5 * size + 11 + beams * (2 + size)
    return COPIES * FLOAT * USUAL_CELLS * a_cell


def most_beams(size: int) -> int:
    """The most beams of which the usual cells of one run fit."""
    none, one = run_bytes(size, 0), run_bytes(size, 1)
    return int((CELLS_GB * 1e9 - none) / (one - none))


def runs_at_once(problem: Problem) -> int:
    """Of how many runs the usual cells fit."""
    fit = CELLS_GB * 1e9 / run_bytes(problem.space.size, len(problem.sensor.bearings))
    return max(1, min(MOST_RUNS_AT_ONCE, int(fit)))
