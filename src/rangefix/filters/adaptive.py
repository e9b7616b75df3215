"""The adaptive point-mass filter: finds where the posterior is, and puts its cells there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from .estimator import Estimate
from .motion import Stationary
from .problem import Prior, Problem
from .refine import Accuracy, Quadrature, Target, refine
from .search import SearchTable, build_table, survivors
from .space import Array

STRETCH = (
    1.0,
    10.0,
    100.0,
    np.inf,
)  # times the margin: a measurement that fits nowhere is looked for more widely


@dataclass(frozen=True)
class AdaptiveBelief:
    """What has been measured since the start, and the posterior that follows.

    measurements: (U, B); readings of different beams share a row.
    states, log_mass: Weighted points, (K, n) and (K,), the masses summing to one; none before a measurement.
    mode: Which mode each point belongs to, (K,).
    estimate: What it comes down to.
    """

    measurements: Array
    states: Array
    log_mass: Array
    mode: NDArray[np.int64]
    estimate: Estimate


@dataclass(frozen=True)
class AdaptivePointMassFilter:
    """The posterior of an object that stays where it is, with cells only where the posterior is.

    A table of the least and greatest range from every coarse cell bounds the likelihood; what survives is
    halved, bounded again and dropped or halved on, until cells are as narrow as the posterior, in its own
    axes. Cells are dropped only where the bound on their density is below `drop` times the greatest. The
    bounds rest on rays cast from points spread over each cell, with an allowance, measured when the table is
    built, for structure thinner than their spacing: about 2 poses in 1000 may exceed it.

    Args:
        problem: The problem; its motion must be `Stationary`, its space x1, x2 and perhaps the heading, and
            its sensor a `Rangefinder`.
        width: Cell size over the posterior's standard deviation, in each mode's own axes.
        drop: Density, relative to the greatest, below which cells are dropped.
        table_rays: About how many rays to spend on the table.
        most_cells: The most cells in one step of refinement.

    Raises:
        ValueError: If the problem is of another kind, or an option is out of bounds.
    """

    problem: Problem
    width: float = 1.0
    drop: float = 1e-8
    table_rays: int = 20_000_000
    most_cells: int = 5_000_000
    table: SearchTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.problem.motion, Stationary):
            raise ValueError("the adaptive point-mass filter is for an object that stays where it is")
        if extra := set(self.problem.space.names) - {"x1", "x2", "heading"}:
            raise ValueError(f"the adaptive point-mass filter estimates no {', '.join(sorted(extra))}")
        if getattr(self.problem.sensor, "max_incidence", np.pi / 2) < np.pi / 2:
            raise ValueError("the adaptive point-mass filter knows no largest incidence: use a BeamMixture")
        if not 0 < self.width <= 2:
            raise ValueError(f"the width must be in (0, 2], got {self.width}")
        if not 0 < self.drop < 1e-2:
            raise ValueError(f"the dropped density must be in (0, 0.01), got {self.drop}")
        if self.table_rays < 1000 or self.most_cells < 1000:
            raise ValueError("need at least 1000 rays for the table and 1000 cells")
        table = build_table(self.problem.sensor, self.problem.prior, self.table_rays)
        object.__setattr__(self, "table", table)

    def init(self, prior: Prior, rng: Generator) -> AdaptiveBelief:
        """The prior's moments.

        Raises:
            ValueError: If it is not the problem's prior, for which the table was built.
        """
        if prior is not self.problem.prior:
            raise ValueError("this prior is not the problem's: build the estimator for it")
        size = self.problem.space.size
        nothing = np.zeros((0, len(self.problem.sensor.bearings)))
        estimate = Estimate(prior.mean, prior.covariance, 0.0)
        return AdaptiveBelief(nothing, np.zeros((0, size)), np.zeros(0), np.zeros(0, np.int64), estimate)

    def predict(self, belief: AdaptiveBelief, control: Array, rng: Generator) -> AdaptiveBelief:
        """The same belief: the object stays where it is."""
        return belief

    def update(self, belief: AdaptiveBelief, measurement: Array, rng: Generator) -> AdaptiveBelief:
        """Bayes' rule for a measurement (B,); NaN = beam not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (B,).
            TooManyCells: If the posterior is spread over more cells than `most_cells`.
        """
        measurement = np.asarray(measurement, dtype=float)
        if measurement.shape != belief.measurements.shape[1:]:
            raise ValueError(
                f"need a measurement of shape {belief.measurements.shape[1:]}, got {measurement.shape}"
            )
        if np.isnan(measurement).all() or belief.estimate.log_evidence == -np.inf:
            return belief
        measurements = _joined(belief.measurements, measurement)
        found = self._integrate(measurements)
        if found is None or found.log_integral == -np.inf:
            impossible = belief.estimate._replace(log_evidence=-np.inf)
            return replace(belief, measurements=measurements, estimate=impossible)
        mean, covariance = self.problem.space.moments(found.states, np.exp(found.log_mass))
        estimate = Estimate(mean, covariance, found.log_integral)
        return AdaptiveBelief(measurements, found.states, found.log_mass, found.mode, estimate)

    def estimate(self, belief: AdaptiveBelief) -> Estimate:
        """Posterior mean (n,), conditional covariance (n, n) and log evidence."""
        return belief.estimate

    def _integrate(self, measurements: Array) -> Quadrature | None:
        """Search the table, then refine; more widely where the measurements fit nowhere."""
        sensor, prior, table = self.problem.sensor, self.problem.prior, self.table
        target = Target(sensor, prior.log_density, measurements)
        readings = int((~np.isnan(measurements)).sum())
        share = readings / int((~np.isnan(measurements)).any(axis=0).sum())
        slack = table.allowance[0] + table.allowance[1] * readings
        margin = -float(np.log(self.drop))
        accuracy = Accuracy(margin, self.width, self.most_cells)
        for stretch in STRETCH:
            starts, size = self._starts(measurements, margin * stretch)
            if not len(starts):
                continue

            def limit(beams: int, wider: float = margin * stretch) -> float:
                return float(table.limit(beams * share, wider))

            found = refine(target, starts, size, limit, slack, accuracy)
            if found is not None and found.shortfall + margin <= limit(round(readings / share)):
                return found
        return found if len(starts) else None

    def _starts(self, measurements: Array, margin: float) -> tuple[Array, Array]:
        """States (K, n) at the centres of the boxes that may hold the true one, and the boxes' size (n,)."""
        table, space = self.table, self.problem.space
        kept = np.ones((len(table.centres), len(table.headings)), np.bool_)
        for measurement in measurements:
            kept &= survivors(table, self.problem.sensor, measurement, margin)
        cells, headings = np.nonzero(kept)
        quarter = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)]) * table.size[:2]
        whole = table.whole[cells]
        centres = np.concatenate(
            [(table.centres[cells[whole], None] + quarter).reshape(-1, 2), table.centres[cells[~whole]]]
        )
        angles = table.headings[np.concatenate([np.repeat(headings[whole], 4), headings[~whole]])]
        states = np.empty((len(centres), space.size))
        size = np.empty(space.size)
        states[:, space.position_indices], size[space.position_indices] = centres, table.size[:2] / 2
        if "heading" in space.names:
            axis = space.names.index("heading")
            states[:, axis], size[axis] = angles, table.size[2]
        return states, size


def _joined(measurements: Array, fresh: Array) -> Array:
    """Measurements (U, B) with one more, in the first row whose beams it does not repeat."""
    for row, measurement in enumerate(measurements):
        if not (~np.isnan(measurement) & ~np.isnan(fresh)).any():
            joined = measurements.copy()
            joined[row] = np.where(np.isnan(fresh), measurement, fresh)
            return joined
    return np.vstack([measurements, fresh])
