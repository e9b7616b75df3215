"""The adaptive point-mass filter: finds where the posterior is, and puts its cells there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import Array, keep_whole
from ...thread_pools import with_blas_on_one_thread
from ..estimate import BriefRepr, Estimate
from ..images import IMAGE_DRAWS, image_of_points, image_rng
from ..measurement import check_reading
from ..models.correlated import refuse_shared_errors
from ..models.motion import Stationary
from ..models.wrapped_noise import reading_bias
from ..optional_methods import Image
from ..prior_ends import Answers, Ends, FarReaching, may_lie_beyond, open_ends, out_of_reach
from ..problem import Prior, Problem
from ..space import StateSpace, is_definite
from .belief import AdaptiveBelief
from .gauss_newton import Peaks
from .lattices.mode_gaussians import sample_modes
from .lattices.quadrature import Accuracy, Quadrature
from .modes import refined, verified, with_lattices
from .options import LEAST_CELLS, LEAST_RAYS, check_options, unknown_to_lattices
from .prediction.moves import finer, predict_exactly, predict_modes
from .prediction.predicted import Before, Predicted
from .range_table import TABLE_RAYS, SearchTable, build_table, table_shape
from .search import MAX_GUESSES_PER_PART, ModeSearch
from .target import Target, TooManyCells, Work

PRIOR_DRAWS = 100_000  # that tell whether a prior's heading has a mean direction
MOST_INHERITED = 1.0  # deviations: no error before a move counts for more after it
FAR_BOUNDS = 100_000_000  # in the table of places far out in a Gaussian prior: 400 MB
SMOOTH_SHARE = 0.02  # of the accuracy, in nats: by how much a polynomial for many Gaussians may be off
MAX_SHORTFALL_NATS = 1e9  # of a perfect fit: beyond it a double has too few digits left to tell states apart


@dataclass(frozen=True, repr=False)
class AdaptivePointMassFilter(BriefRepr):
    """The posterior on lattices that lie where it is, each in the axes of its own mode.

    A table of the least and greatest range from every coarse cell of the prior's support bounds the
    likelihood there; from the cells that are left, trimmed Gauss-Newton steps lead to the modes, and each
    mode is integrated over a lattice that grows until its density ends, and is halved until it is accurate.
    The table's bounds rest on rays cast from points spread over each cell, with an allowance, measured when
    it is built, for structure thinner than their spacing: about 2 poses in 1000 may exceed it. After a move
    the modes' points are the guesses.

    The table covers a Gaussian prior to 6 deviations. Readings that lead farther, or fit nowhere there, are
    looked for once more to 40; where that table is too large, or ends too early, `error` is inf.

    Args:
        problem: The problem; its sensor must expect what its map says, with no largest incidence.
        accuracy: Error allowed: of the mean in standard deviations, of the covariance in variances and of
            probabilities, as the lattices' own halves show it.
        drop: Density, relative to the greatest, below which no mode is looked at.
        table_rays: About how many rays to spend on the table.
        most_cells: The most cells of one mode.

    Raises:
        ValueError: If the problem is of another kind, or an option is out of bounds.
    """

    problem: Problem
    accuracy: float = 0.02
    drop: float = 1e-9
    table_rays: int = TABLE_RAYS
    most_cells: int = 1_000_000

    def __post_init__(self) -> None:
        if why := unknown_to_lattices(self.problem):
            raise ValueError(f"the adaptive point-mass filter {why}")
        refuse_shared_errors(self.problem.sensor, "the adaptive point-mass filter")
        check_options(self.accuracy, self.drop)
        keep_whole(self, "table_rays", LEAST_RAYS)
        keep_whole(self, "most_cells", LEAST_CELLS)
        self.table  # noqa: B018 (refuses what does not fit, and is cast before the first update)

    @cached_property
    def table(self) -> SearchTable:
        """Bounds of the ranges from the coarse cells of the prior's support."""
        return build_table(self.problem.sensor, self.problem.prior, self.table_rays)

    @cached_property
    def _ends(self) -> Ends | None:
        """Where the table ends though the prior does not."""
        return open_ends(self.problem.prior)

    @cached_property
    def _far(self) -> AdaptivePointMassFilter | None:
        """The same filter with a table that goes farther along a Gaussian prior; None if it is too large."""
        problem = replace(self.problem, prior=FarReaching(self.problem.prior))
        (rows, columns), directions, _ = table_shape(problem.sensor, problem.prior, self.table_rays)
        return replace(self, problem=problem) if rows * columns * directions <= FAR_BOUNDS else None

    def init(self, prior: Prior, rng: Generator) -> AdaptiveBelief:
        """The prior's moments.

        Raises:
            ValueError: If it is not the problem's prior, for which the table was built.
        """
        if prior is not self.problem.prior:
            raise ValueError("this prior is not the problem's: build the estimator for it")
        return AdaptiveBelief(prior, None, np.zeros((0, len(self.problem.sensor.bearings))), None, 0.0)

    @with_blas_on_one_thread
    def predict(self, belief: AdaptiveBelief, control: Array, rng: Generator) -> AdaptiveBelief:
        """The belief after a move, control (k,).

        Raises:
            TooManyCells: If the belief before it fills more cells than can be moved.
        """
        if isinstance(self.problem.motion, Stationary):
            return belief
        before, control = self._cells(belief), np.asarray(control, dtype=float)
        told = self._targets(belief.prior, None, belief.measurements)[0]
        target = replace(told, work=Work(np.inf))
        rests_on = belief.prior.rests_on if isinstance(belief.prior, Predicted) else 0
        density, motion = Before(target, before.log_integral, rests_on), self.problem.motion
        evidence = self._evidence(belief, before)
        if np.isfinite(before.missed):
            exactly = predict_exactly(before.modes, density, motion, control)
            if exactly is not None:
                known, inherited = belief.measurements[:0], belief.inherited
                return AdaptiveBelief(
                    exactly, exactly.inexact, known, None, evidence, belief.possible, inherited
                )
        modes = finer(before, told, self._accuracy, motion, control)
        allowed = SMOOTH_SHARE * self.accuracy
        prior = predict_modes(modes, density, motion, control, allowed=allowed)
        check = predict_modes(before.checks or before.modes, density, motion, control, prior, allowed)
        inherited = min(self.error(belief), MOST_INHERITED)
        return AdaptiveBelief(
            prior, check, belief.measurements[:0], None, evidence, belief.possible, inherited
        )

    @with_blas_on_one_thread
    def update(self, belief: AdaptiveBelief, measurement: Array, rng: Generator) -> AdaptiveBelief:
        """Bayes' rule for a measurement (B,); NaN = beam not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (B,) or not of real numbers.
            TooManyCells: If a mode of the posterior is spread over more cells than `most_cells`.
        """
        measurement = check_reading(self.problem.sensor, measurement)
        if np.isnan(measurement).all() or not belief.possible:
            return belief
        if not self._shortfall(measurement) < MAX_SHORTFALL_NATS:
            return replace(belief, possible=False)
        measurements = _joined(belief.measurements, measurement)
        if isinstance(belief.prior, Predicted) or self._ends is None:
            posterior = self._posterior(belief.prior, belief.check, measurements)
        else:
            posterior = self._from_open_prior(measurements, self._ends)
        perfect = self._targets(belief.prior, None, measurements)[0].perfect()
        if not posterior.modes or not perfect - posterior.level < MAX_SHORTFALL_NATS:
            return replace(belief, possible=False)
        return replace(belief, measurements=measurements, posterior=posterior)

    @with_blas_on_one_thread
    def estimate(self, belief: AdaptiveBelief) -> Estimate:
        """Posterior mean (n,), conditional covariance (n, n) and log evidence."""
        if (prior := belief.untouched) is not None:
            return Estimate(prior.mean, prior.covariance, belief.log_evidence if belief.possible else -np.inf)
        cells = self._cells(belief)
        _, mean, covariance, _ = cells.moments
        if not is_definite(covariance):
            covariance = covariance + cells.between_points
        return Estimate(mean, covariance, self._evidence(belief, cells) if belief.possible else -np.inf)

    @with_blas_on_one_thread
    def error(self, belief: AdaptiveBelief) -> float:
        """Numerical error of mean and covariance in deviations, by lattices that did not make them.

        What was off before a move is still off after it, as far as measurements have not made up for it.
        """
        if not belief.possible or belief.untouched is not None:
            return 0.0
        cells, inherited = self._cells(belief), belief.inherited
        if inherited > 0 and belief.posterior is not None and isinstance(belief.prior, Predicted):
            std = np.sqrt(np.diagonal(cells.moments.covariance))
            inherited *= min(1.0, float((std / belief.prior.deviations).max()))
        return float(np.hypot(cells.error, inherited))

    @with_blas_on_one_thread
    def resultant(self, belief: AdaptiveBelief) -> float:
        """Length of the mean resultant vector of the heading: see `CanTellDirection`.

        Raises:
            NotImplementedError: If the heading is known.
        """
        if self.problem.space.heading is not None:
            raise NotImplementedError("the heading is known")
        if (prior := belief.untouched) is not None:
            return resultant_of_draws(self.problem.space, prior)
        return self._cells(belief).moments.resultant

    @with_blas_on_one_thread
    def sample(self, belief: AdaptiveBelief, size: int, rng: Generator) -> Array:
        """Draws from the belief, (size, n), with the mean and covariance that it claims."""
        if (prior := belief.untouched) is not None:
            return prior.sample(size, rng)
        return sample_modes(self._cells(belief).modes, size, rng)

    def density(self, belief: AdaptiveBelief) -> Image:
        """Draws from the belief counted in pixels, for pictures: its lattices lie askew to them."""
        return image_of_points(self.sample(belief, IMAGE_DRAWS, image_rng()), self.problem)

    @staticmethod
    def _evidence(belief: AdaptiveBelief, cells: Quadrature) -> float:
        """Log evidence of all that was measured; the cells of a mere prediction add nothing."""
        return belief.log_evidence + (cells.log_integral if len(belief.measurements) else 0.0)

    def _cells(self, belief: AdaptiveBelief) -> Quadrature:
        """The belief on lattices."""
        if belief.posterior is not None:
            return belief.posterior
        prior = belief.prior
        target, check = self._targets(prior, belief.check, belief.measurements[:0])
        if isinstance(prior, Predicted):
            states, information = prior.middles(), prior.means_and_precisions()[1]
        else:
            states = np.vstack([prior.mean, prior.sample(MAX_GUESSES_PER_PART, np.random.default_rng(0))])
            information = np.asarray(np.linalg.inv(prior.covariance), dtype=float)
        logs = target.log_density(states)
        peaks = Peaks(states, logs, logs, np.broadcast_to(information, (*states.shape, states.shape[1])))
        found = refined(target, with_lattices(target, peaks, self._accuracy), self._accuracy)
        if isinstance(prior, Predicted) and prior.is_blurred:
            draws = prior.draws(self._search.draws_asked)
            found = replace(found, missed=prior.blur(draws.parts, draws.log_mass))
        return verified(target, check, found, self._accuracy)

    def _targets(
        self, prior: Prior | Predicted, check: Predicted | None, measurements: Array
    ) -> tuple[Target, Target]:
        """The posterior, and the same from the prior that checks it; they share their work."""
        sensor = self.problem.sensor
        if not isinstance(prior, Predicted):
            target = Target(sensor, prior.log_density, measurements)
            return target, target
        target = Target(sensor, prior.law, measurements, prior.cost)
        if check is None or prior.exact is not None:
            return target, target
        return target, replace(target, log_prior=check.log_density, log_prior_cost=check.cost)

    @property
    def _accuracy(self) -> Accuracy:
        return Accuracy(self.accuracy, -float(np.log(self.drop)), self.most_cells)

    @property
    def _search(self) -> ModeSearch:
        return ModeSearch(self.problem, self.table, self._accuracy)

    def _posterior(
        self, prior: Prior | Predicted, check: Predicted | None, measurements: Array
    ) -> Quadrature:
        """Where measurements (U, B) leave the prior.

        Raises:
            TooManyCells: If that takes more work or cells than allowed.
        """
        target, other = self._targets(prior, check, measurements)
        if not isinstance(prior, Predicted):
            found, survey = self._search.fix(prior, target)
        else:
            try:
                found, survey = self._search.after_move(prior, target)
            except TooManyCells:
                if check is None:
                    raise
                coarse = self._targets(check, None, measurements)[0]
                found = refined(coarse, self._search.after_move(check, coarse)[0], self._accuracy)
                return replace(found, missed=np.inf)  # coarser by an unknown amount, rather than no answer
        if not found.modes:
            return found
        found = refined(target, found, self._accuracy)
        if survey is None:
            return verified(target, other, found, self._accuracy)
        try:
            again = self._search.completed(target, found, survey)  # finer lattices hold less
            if len(again.modes) > len(found.modes):
                again = refined(target, again, self._accuracy)
            again = verified(target, other, again, self._accuracy)
            return replace(again, missed=survey.missed(again))
        except TooManyCells:
            if not isinstance(prior, Predicted):
                raise
            return replace(found, missed=np.inf)  # nothing tells any more what it misses

    def _from_open_prior(self, measurements: Array, ends: Ends) -> Quadrature:
        """Where measurements (U, B) leave a prior that goes on where the table ends."""
        sensor, prior = self.problem.sensor, self.problem.prior
        found = self._posterior(prior, None, measurements)
        if found.modes and not may_lie_beyond(sensor, prior, ends, measurements[None], _answers(found))[0]:
            return found
        if self._far is None:
            return replace(found, missed=np.inf)
        found = self._far._posterior(self._far.problem.prior, None, measurements)
        if found.modes and out_of_reach(sensor, prior, measurements[None], _answers(found))[0]:
            return replace(found, missed=np.inf)
        return found

    def _shortfall(self, measurement: Array) -> float:
        """By how many nats readings (B,) fall short of a perfect fit, at least, wherever they were taken."""
        sensor = self.problem.sensor
        lower, upper = sensor.room.bounds
        longest = float(np.linalg.norm(np.asarray(upper) - lower))
        fit = measurement - reading_bias(sensor.noise)
        nearest = np.stack([np.clip(fit, 0.0, longest), np.full_like(fit, np.inf)])
        with np.errstate(invalid="ignore"):
            best = sensor.beam_log_density(measurement, nearest).max(axis=0)
            perfect = sensor.beam_log_density(measurement, np.maximum(fit, 0.0))
            return float((perfect - best).sum())


def _answers(found: Quadrature) -> Answers:
    """Mean (1, n), covariance (1, n, n) and log evidence (1,) of a posterior."""
    moments = found.moments
    return moments.mean[None], moments.covariance[None], np.array([found.log_integral])


def resultant_of_draws(space: StateSpace, prior: Prior) -> float:
    """Length of the mean resultant vector of a prior's heading."""
    headings = prior.sample(PRIOR_DRAWS, np.random.default_rng(0))[:, space.names.index("heading")]
    return float(np.abs(np.exp(1j * headings).mean()))


def _joined(measurements: Array, fresh: Array) -> Array:
    """Measurements (U, B) with one more, in the first row whose beams it does not repeat."""
    for row, measurement in enumerate(measurements):
        if not (~np.isnan(measurement) & ~np.isnan(fresh)).any():
            joined = measurements.copy()
            joined[row] = np.where(np.isnan(fresh), measurement, fresh)
            return joined
    return np.vstack([measurements, fresh])
