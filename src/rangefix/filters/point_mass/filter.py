"""The point-mass filter on a fixed grid (Bucy and Senne, 1971; for this problem Stepanov and Mansour)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, Array, IntArray, keep_whole
from ..estimate import BriefRepr, Estimate
from ..images import image_of_cells
from ..measurement import check_measurement, count_runs
from ..models.motion import refuse_moving
from ..optional_methods import Image
from ..prior_ends import leaning, open_ends
from ..problem import Prior, Problem
from ..sampling import cell_draws, gaussian_draws
from ..space import deviations_apart, is_definite, may_lack_direction, resultant_of_cells
from .belief import PointMassBelief, mixed, runs_of, some_runs
from .cell_ranges import CellRanges, cast_cells
from .grid import Grid, build_grid
from .records import CellMass, Readings

MEMORY_GB = 0.6  # of expected ranges: 25 million of them, three times
SUM_ROUNDING = 1e-10  # of a covariance summed over cells
OTHER_SHIFTS = (0.382, 0.618)  # of a cell, by which other cells are shifted against these
SURE_APART = 0.005  # deviations: where one shifted lattice is no further off no other is asked
ERROR_FACTOR = 1.5  # on the difference to theirs, for it may be small by chance
DENSITIES_AT_ONCE = 1 << 18  # log densities, where noise is not Gaussian: they stay in the cache


@dataclass(frozen=True, repr=False)
class PointMassFilter(BriefRepr):
    """The exact posterior, up to cell size, for an object that stays where it is.

    Weights are worked out at cell centres. A posterior narrower than a cell would then claim a spread near
    zero, while the centre it reports is off by up to half a cell or, where components are correlated, by
    several. So the covariance is raised by the mean squared error of lattice sums, found mode by mode from
    the weights about a few heavy cells (`mode_shape`, docs/decisions/0002-cell-width.md). Where cells are
    at most 1.8 deviations wide in every direction hardly anything is added.

    Where all possible cells lie in a row, as in a slit thinner than they are, each counts as even within:
    1 / 12 of its size squared is added along each axis, for no slit is a line.

    What is not raised is doubt about which mode is right. A mode is weighed by its best cell, and with sharp
    noise on wide cells that cell may fall hundreds of nats short of the mode's peak. Modes that mirror each
    other fall short alike; of others one wins by how the cells happen to lie.

    Args:
        problem: The problem; its motion must be `Stationary`.
        cell: Largest cell size, one number or one for each component; m, or rad for a heading.
        heading_cell: That of an unknown heading, rad, where `cell` is one number for the others.
        most_cells: The most cells that the prior's support may be divided into.
        memory_gb: The most that the expected ranges may take, GB, with those of two shifted grids, which
            tell the error; posteriors come on top.
        cell_correction: Whether the covariance is raised by what cells wider than the posterior miss. Without
            it the filter is the paper's.
        shift: By which share of a cell the grid begins before the prior's support, 0 to 1.

    Raises:
        ValueError: If the cell size or memory_gb is not positive, most_cells is no whole number, the shift is
            out of bounds, there are too many cells or ranges, no cell is in free space, or heading_cell is
            given for a known heading or beside several sizes.
    """

    problem: Problem
    cell: ArrayLike
    heading_cell: float | None = None
    most_cells: int = 20_000_000
    memory_gb: float = MEMORY_GB
    cell_correction: bool = True
    shift: float = 0.0

    def __post_init__(self) -> None:
        refuse_moving(
            self.problem.motion, "the fixed-grid point-mass filter", "adaptive-point-mass or particle"
        )
        keep_whole(self, "most_cells", 1)
        if not self.memory_gb > 0:
            raise ValueError(f"memory_gb must be positive, got {self.memory_gb}")
        if not 0 <= self.shift <= 1:
            raise ValueError(f"the grid's shift must be from 0 to 1 cell, got {self.shift}")
        self.cells  # noqa: B018 (refuses what does not fit, and is cast before the first update)

    @cached_property
    def grid(self) -> Grid:
        """The cells that the prior allows."""
        return build_grid(self.problem.prior, self.problem.space, self._sizes, self.most_cells, self.shift)

    @cached_property
    def cells(self) -> CellRanges:
        """The ranges that the cells expect."""
        return cast_cells(self.grid, self.problem.sensor, 1e9 * self.memory_gb)

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> PointMassBelief:
        """The prior's probability of each cell, the same for all runs.

        Raises:
            ValueError: If the prior is not the problem's, and of other components or reaches beyond the grid,
                or there is no run.
        """
        space = self.problem.space
        if prior is not self.problem.prior:
            if prior.support[0].shape != (space.size,):
                raise ValueError(f"this prior is not over {', '.join(space.names)}, the problem's components")
            if not self.grid.holds(prior, space):
                raise ValueError("this prior reaches beyond the grid: build the estimator for it")
        runs, beams = count_runs(rngs), len(self.problem.sensor.bearings)
        one = self._first if prior is self.problem.prior else self._of_one_run(prior)
        shared = Estimate(*(np.repeat(value, runs, axis=0) for value in one.estimate))
        counts, readings = np.zeros((2, runs, beams))
        nothing = np.zeros((runs, 0, beams))
        return PointMassBelief(
            one.log_mass, one.top_mass, counts, readings, np.zeros(runs), shared, prior, nothing
        )

    @cached_property
    def _first(self) -> PointMassBelief:
        """What one run believes at first; asked for with each batch of runs."""
        return self._of_one_run(self.problem.prior)

    def _of_one_run(self, prior: Prior) -> PointMassBelief:
        """A prior as the belief of one run."""
        log_mass, beams = self._prior_mass(prior), len(self.problem.sensor.bearings)
        blank = Estimate(np.zeros((1, 0)), np.zeros((1, 0, 0)), np.zeros(1))
        none = np.zeros((1, beams))
        nothing = np.zeros((1, 0, beams))
        first = PointMassBelief(
            log_mass, self.cells.top(log_mass), none, none, np.zeros(1), blank, prior, nothing
        )
        return self._finish(first, None)

    def predict(self, belief: PointMassBelief, control: Array, rngs: Sequence[Generator]) -> PointMassBelief:
        """The same belief: the object stays where it is."""
        return belief

    def update(
        self, belief: PointMassBelief, measurement: Array, rngs: Sequence[Generator]
    ) -> PointMassBelief:
        """Bayes' rule for a measurement (M, B); NaN = beam not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = check_measurement(self.problem.sensor, measurement, len(belief.counts))
        if self.problem.sensor.gaussian_stds is not None:
            return self._finish(self._with_readings(belief, measurement), belief)
        return self._finish(self._with_densities(belief, measurement), belief)

    def estimate(self, belief: PointMassBelief) -> Estimate:
        """Posterior mean (M, n), conditional covariance (M, n, n) and log evidence (M,)."""
        return belief.estimate

    @cached_property
    def other_cells(self) -> tuple[PointMassFilter, ...]:
        """The same filter on cells of the same size, shifted against these to either side."""
        room = replace(self, most_cells=4 * self.most_cells, memory_gb=2 * self.memory_gb)
        return tuple(replace(room, shift=shift) for shift in OTHER_SHIFTS)

    def error(self, belief: PointMassBelief) -> Array:
        """How far mean and covariance may be off for cells of this size, in posterior deviations, (M,).

        Half as much again as the difference to what cells answer that are shifted against these, to either
        side: together they see a wall or a jump as finer cells would. Those to the other side are asked only
        where the first are not of one mind with these. A mode that all miss is not told. Of a posterior that
        leans on where the grid ends, 6 deviations from a Gaussian prior's mean, nothing is known: inf. Nor
        is anything where headings may be so evenly spread that none is their mean: shifted grids that agree
        there do so by chance.
        """
        space, estimate = self.problem.space, belief.estimate
        first, second = self.other_cells
        one = first._told_the_same(belief)
        apart = ERROR_FACTOR * deviations_apart(space, estimate, one)
        apart = np.where(np.asarray(one.log_evidence) > -np.inf, apart, np.inf)
        unsure = np.flatnonzero(apart > SURE_APART)
        if len(unsure):
            mine, half = runs_of(estimate, unsure), runs_of(one, unsure)
            reference = mixed(space, (half, second._told_the_same(some_runs(belief, unsure))))
            both = ERROR_FACTOR * deviations_apart(space, mine, reference)
            apart[unsure] = np.where(reference.log_evidence > -np.inf, both, np.inf)
        if (ends := open_ends(belief.prior)) is not None:
            apart[leaning(space, ends, (estimate.mean, estimate.covariance, estimate.log_evidence))] = np.inf
        lacking = may_lack_direction(
            space, estimate.covariance, apart, lambda run: self._resultant(belief, run)
        )
        apart[lacking] = np.inf
        return np.where(np.asarray(estimate.log_evidence) > -np.inf, apart, 0.0)

    def resultant(self, belief: PointMassBelief) -> Array:
        """Length of the mean resultant vector of the heading, (M,): see `CanTellDirection`.

        1 where no cell is possible any more.

        Raises:
            NotImplementedError: If the heading is known.
        """
        if self.problem.space.heading is not None:
            raise NotImplementedError("the heading is known")
        return np.array([self._resultant(belief, run) for run in range(len(belief.counts))])

    def _resultant(self, belief: PointMassBelief, run: int) -> float:
        """That of one run."""
        if np.asarray(belief.estimate.log_evidence)[run] == -np.inf:
            return 1.0
        which, logs = self._heavy_cells(belief, run)
        return resultant_of_cells(self.grid.centres[which, self.problem.space.names.index("heading")], logs)

    def _told_the_same(self, belief: PointMassBelief) -> Estimate:
        """What these cells answer to all that another grid's belief has been told."""
        log_mass = self._prior_mass(belief.prior)
        mine = replace(belief, log_mass=log_mass, top_mass=self.cells.top(log_mass))
        if self.problem.sensor.gaussian_stds is None:
            for measurement in np.moveaxis(belief.measurements, 1, 0):
                mine = self._with_densities(mine, measurement)
        return self._finish(mine, belief).estimate

    def _prior_mass(self, prior: Prior) -> Array:
        """Log probability of each cell under a prior, (1, G).

        Raises:
            ValueError: If it is not the problem's, and allows no cell.
        """
        if prior is self.problem.prior:
            return self.grid.log_mass[None]
        log_mass = prior.log_density(self.grid.centres)
        if log_mass.max() == -np.inf:
            raise ValueError("this prior allows no cell of the grid: build the estimator for it")
        return np.asarray(log_mass - np.logaddexp.reduce(log_mass))[None]

    def posterior(self, belief: PointMassBelief) -> Array:
        """Probability of each cell of `grid`, (M, G); rows sum to one, or are 0 where no cell is possible."""
        return np.stack([self._probabilities(belief, run) for run in range(len(belief.counts))])

    def _probabilities(self, belief: PointMassBelief, run: int) -> Array:
        """Probability of each cell in one run, (G,); 0 where no cell is possible."""
        if np.asarray(belief.estimate.log_evidence)[run] == -np.inf:
            return np.zeros(len(self.grid.centres))
        logs = self._log_weights(belief, run)
        weights: Array = np.exp(logs - logs.max())
        weights /= weights.sum()
        return weights

    def sample(self, belief: PointMassBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the cells and within them, with the claimed mean and covariance, (M, size, n).

        Where no cell is possible any more: from the Gaussian of what was believed before.
        """
        space, grid = self.problem.space, self.grid
        mean, covariance, log_evidence = belief.estimate
        draws = gaussian_draws(mean, covariance, size, space, rngs)
        some = np.flatnonzero(np.asarray(log_evidence) > -np.inf)
        heavy = (self._heavy_cells(belief, int(run)) for run in some)
        cells = ((grid.centres.take(which, axis=0), grid.step, logs) for which, logs in heavy)
        claim = mean[some], covariance[some]
        draws[some] = cell_draws(cells, claim, size, space, [rngs[int(run)] for run in some])
        return draws

    def density(self, belief: PointMassBelief, run: int) -> Image:
        """The probabilities of a run's cells, for pictures.

        Raises:
            NotImplementedError: If no cell is possible any more.
        """
        if np.asarray(belief.estimate.log_evidence)[run] == -np.inf:
            raise NotImplementedError("nothing is possible any more: there is no density to show")
        masses = self.grid.image(self._probabilities(belief, run))
        return image_of_cells(masses, self.grid.lower, self.grid.step, self.problem.space)

    def _log_weights(self, belief: PointMassBelief, run: int) -> Array:
        """Log probability of each cell in one run, not normalised, (G,)."""
        log_mass: Array = belief.log_mass[run if len(belief.log_mass) > 1 else 0]
        precision = belief.counts[run] * self._precision
        return log_mass - self.cells.misfit(belief.readings[run], precision) if precision.any() else log_mass

    def _heavy_cells(self, belief: PointMassBelief, run: int) -> tuple[IntArray, Array]:
        """The cells of one run that are not negligible, and their log weights, not normalised."""
        row = run if len(belief.log_mass) > 1 else 0
        mass = CellMass(belief.log_mass[row], belief.top_mass[row])
        return self.cells.heavy(belief.readings[run], belief.counts[run] * self._precision, mass)

    @property
    def _sizes(self) -> ArrayLike:
        """Largest cell sizes, one number or one for each component."""
        if self.heading_cell is None:
            return self.cell
        angle = self.problem.space.is_angle
        if not angle.any() or np.ndim(self.cell):
            raise ValueError("heading_cell is for an unknown heading, and needs one number for cell")
        return np.where(angle, self.heading_cell, np.asarray(self.cell, dtype=float))

    @cached_property
    def _precision(self) -> Array:
        """1 / variance of each beam, (B,); zeros where the noise is not Gaussian."""
        stds = self.problem.sensor.gaussian_stds
        return np.zeros(len(self.problem.sensor.bearings)) if stds is None else 1 / stds**2

    @cached_property
    def _log_peaks(self) -> Array:
        """Log density of each beam at the range that is expected, (B,); the noise is Gaussian."""
        return np.asarray(0.5 * (np.log(self._precision) - LOG_TWO_PI))

    @cached_property
    def _log_peak(self) -> float:
        """That of all beams."""
        return float(self._log_peaks.sum())

    def _with_readings(self, belief: PointMassBelief, measurement: Array) -> PointMassBelief:
        """Gaussian noise: the readings join those of before as counts, means and a common factor."""
        finite = np.count_nonzero(np.isfinite(measurement)) == measurement.size
        if finite and not belief.measurements.size:  # the usual case: nothing to join
            counts, readings = np.ones(measurement.shape), measurement.copy()
            measurements = readings[:, None]
            log_scale = belief.log_scale + self._log_peak
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
                counts, readings, common = self._joined(belief, measurement)
                log_scale = belief.log_scale + common.sum(1)
            measurements = np.concatenate([belief.measurements, measurement[:, None]], axis=1)
        mass = belief.log_mass, belief.top_mass
        return PointMassBelief(
            *mass, counts, readings, log_scale, belief.estimate, belief.prior, measurements
        )

    def _joined(self, belief: PointMassBelief, measurement: Array) -> tuple[Array, Array, Array]:
        """Counts and means of the readings with those of a measurement, and the log of the factor, (M, B)."""
        measured = ~np.isnan(measurement)
        returned = np.isfinite(measurement)
        counts = belief.counts + measured
        fresh = np.where(measured, measurement, belief.readings)
        finite = returned & np.isfinite(belief.readings)
        step = np.subtract(fresh, belief.readings, out=np.zeros_like(fresh), where=finite)
        readings = np.where(finite, belief.readings + step / np.maximum(counts, 1), fresh)
        mixed = (belief.counts > 0) & measured & (returned != np.isfinite(belief.readings))
        spread = 0.5 * self._precision * step**2 * belief.counts / np.maximum(counts, 1)
        common = np.where(returned, self._log_peaks - spread, 0.0)
        common[mixed] = -np.inf  # one beam, from one place, both met a wall and met none
        return counts, readings, common

    def _with_densities(self, belief: PointMassBelief, measurement: Array) -> PointMassBelief:
        """Any noise: the log density of the measurement at every cell goes into the cells' log mass."""
        (runs, beams), cells = measurement.shape, len(self.grid.centres)
        log_mass = np.broadcast_to(belief.log_mass, (runs, cells)).copy()
        width = max(1, min(cells, DENSITIES_AT_ONCE // beams))
        height = max(1, DENSITIES_AT_ONCE // (width * beams))
        for first in range(0, cells, width):
            expected = self.cells.expected(first, min(first + width, cells))
            for start in range(0, runs, height):
                part = slice(start, start + height)
                density = self.problem.sensor.log_density(measurement[part, None, :], expected)
                log_mass[part, first : first + width] += density
        return replace(
            belief,
            log_mass=log_mass,
            top_mass=self.cells.top(log_mass),
            measurements=np.concatenate([belief.measurements, measurement[:, None]], axis=1),
        )

    def _finish(self, belief: PointMassBelief, before: PointMassBelief | None) -> PointMassBelief:
        """Work out the estimate; runs in which nothing is possible any more keep the one from before."""
        readings = Readings(belief.readings, belief.counts * self._precision)
        mass = CellMass(belief.log_mass, belief.top_mass)
        sums = self.cells.moments(readings, mass, self.cell_correction)
        mean, covariance, log_evidence = sums.means, sums.covariances, belief.log_scale + sums.log_sums
        flat = ~is_definite(covariance, SUM_ROUNDING)
        if self.cell_correction and np.count_nonzero(flat):
            covariance[flat] += np.diag(self.grid.step**2 / 12)  # cells in a row: each is even within
        lost = ~np.isfinite(log_evidence)
        if before is not None and np.count_nonzero(lost):
            mean[lost], covariance[lost] = before.estimate.mean[lost], before.estimate.covariance[lost]
            log_evidence[lost] = -np.inf
        told = belief.counts, belief.readings, belief.log_scale
        estimate = Estimate(mean, covariance, log_evidence)
        return PointMassBelief(*mass, *told, estimate, belief.prior, belief.measurements)
