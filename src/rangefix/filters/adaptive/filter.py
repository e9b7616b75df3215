"""The adaptive point-mass filter: finds where the posterior is, and puts its cells there."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import TWO_PI, Array
from ..estimate import BriefRepr, Estimate, brief
from ..images import IMAGE_DRAWS, image_of_points, image_rng
from ..measurement import check_reading
from ..models.correlated import refuse_shared_errors
from ..models.motion import Stationary
from ..models.wrapped_noise import reading_bias
from ..optional_methods import Image
from ..problem import Prior, Problem, expects_map_ranges
from ..space import StateSpace, is_definite
from .gauss_newton import QUICK_BEAMS, STEPS, Peaks, climb, quick_scores
from .lattice import Lattice, Limits, halved
from .mode_gaussians import kept_count, sample_modes
from .modes import NOWHERE, SEARCH_SHARE, Accuracy, Quadrature, refined, verified, with_lattices
from .predicted import GUESS_BEAMS, Draws, Predicted, coarse_axes, predict_modes
from .range_bounds import SearchTable, build_table, shortfall_bounds
from .target import STATE_COST, WORK, Target, TooManyCells, Work

PRIOR_DRAWS = 100_000  # that tell whether a prior's heading has a mean direction
USUAL_STATES = 15_000  # that a fix looks at: guesses, climbs, a mode and its neighbour
CHECKED_STATES = 16  # at which a sensor is asked whether it expects what its map says
MARGIN_FACTORS = (1.0, 10.0, 100.0, np.inf)  # readings that fit nowhere are looked for more widely
MAX_BOXES = 20_000  # that a search may leave
LOT_NATS = 3.0  # by which those that are left then are drawn by lot
MAX_BOXES_FOLLOWED = 2000  # at once
STEPS_BY_ROUND = (STEPS, STEPS, 0, STEPS, 0)  # without steps, guesses that lead elsewhere count too
MOST_MISSED_NATS = 700.0  # more is as much: nothing of what counts has been found yet
MISSED_SHARE = 0.25  # of the accuracy: how much boxes may count that are not followed
BOX_COMPONENTS = ("x1", "x2", "heading")
FINE_POINTS_MOVED = 10_000  # up to which lattices are made finer before a move among walls
DRAWS_ASKED = 20_000  # that show what the modes found hold nothing of
DRAWS_FOLLOWED = 48  # of those, at once
DRAW_STEPS = (STEPS, 0, 0)  # of the climb from them, round by round
MOST_INHERITED = 1.0  # deviations: no error before a move counts for more after it
MAX_GUESSES_PER_PART = 24  # points of a predicted mode that are followed
UNEXPLAINED_NATS = 1000.0  # short of a perfect fit, from where on no further modes are looked for
MAX_SHORTFALL_NATS = 1e9  # of a perfect fit: beyond it a double has too few digits left to tell states apart


@dataclass(frozen=True)
class AdaptiveBelief:
    """What was predicted, what has been measured since, and the posterior that follows.

    Attributes:
        prior: What was predicted; the problem's prior before the first move.
        check: The same worked out from other points and with wider kernels; None before the first move.
        measurements: Since then, (U, B); readings of different beams share a row.
        posterior: Where it is; None before the first measurement after a move.
        log_evidence: Of all that was measured before `prior`, nats.
        possible: Whether some state allowed the last measurement; if not, the belief is the one before it.
        inherited: Error of mean and covariance before the last move, deviations; at most 1.
    """

    prior: Prior | Predicted
    check: Predicted | None
    measurements: Array
    posterior: Quadrature | None
    log_evidence: float
    possible: bool = True
    inherited: float = 0.0

    def __repr__(self) -> str:
        if self.posterior is None:
            return brief(self)
        return brief(self, Estimate(self.posterior.moments.mean, self.posterior.moments.covariance))


@dataclass(frozen=True, repr=False)
class AdaptivePointMassFilter(BriefRepr):
    """The posterior on lattices that lie where it is, each in the axes of its own mode.

    A table of the least and greatest range from every coarse cell of the prior's support bounds the
    likelihood there; from the cells that are left, trimmed Gauss-Newton steps lead to the modes, and each
    mode is integrated over a lattice that grows until its density ends, and is halved until it is accurate.
    The table's bounds rest on rays cast from points spread over each cell, with an allowance, measured when
    it is built, for structure thinner than their spacing: about 2 poses in 1000 may exceed it. After a move
    the modes' points are the guesses.

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
    table_rays: int = 20_000_000
    most_cells: int = 1_000_000

    def __post_init__(self) -> None:
        if self.problem.sensor.max_incidence < np.pi / 2:
            raise ValueError("the adaptive point-mass filter knows no largest incidence: use a BeamMixture")
        refuse_shared_errors(self.problem.sensor, "the adaptive point-mass filter")
        states = self.problem.prior.sample(CHECKED_STATES, np.random.default_rng(0))
        if not expects_map_ranges(self.problem.sensor, states):
            raise ValueError("the adaptive point-mass filter needs a sensor that expects what its map says")
        check_options(self.accuracy, self.drop, self.table_rays, self.most_cells)
        beams, most = len(self.problem.sensor.bearings), int(WORK / USUAL_STATES - STATE_COST)
        if beams > most:
            raise ValueError(
                f"a fix asks some {USUAL_STATES} states for {beams} ranges each, more than {WORK:.2g} "
                f"rays: take at most {most} beams"
            )
        self.table  # noqa: B018 (refuses what does not fit, and is cast before the first update)

    @cached_property
    def table(self) -> SearchTable:
        """Bounds of the ranges from the coarse cells of the prior's support."""
        return build_table(self.problem.sensor, self.problem.prior, self.table_rays)

    def init(self, prior: Prior, rng: Generator) -> AdaptiveBelief:
        """The prior's moments.

        Raises:
            ValueError: If it is not the problem's prior, for which the table was built.
        """
        if prior is not self.problem.prior:
            raise ValueError("this prior is not the problem's: build the estimator for it")
        return AdaptiveBelief(prior, None, np.zeros((0, len(self.problem.sensor.bearings))), None, 0.0)

    def predict(self, belief: AdaptiveBelief, control: Array, rng: Generator) -> AdaptiveBelief:
        """The belief after a move, control (k,).

        Raises:
            TooManyCells: If the belief before it fills more cells than can be moved.
        """
        if isinstance(self.problem.motion, Stationary):
            return belief
        before, control = self._cells(belief), np.asarray(control, dtype=float)
        prior = predict_modes(self._finer(belief, before, control), self.problem.motion, control)
        check = predict_modes(before.checks or before.modes, self.problem.motion, control, coarse=True)
        evidence = self._evidence(belief, before)
        inherited = min(self.error(belief), MOST_INHERITED)
        return AdaptiveBelief(
            prior, check, belief.measurements[:0], None, evidence, belief.possible, inherited
        )

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
        posterior = self._posterior(belief.prior, belief.check, measurements)
        perfect = self._targets(belief.prior, None, measurements)[0].perfect()
        if not posterior.modes or not perfect - posterior.level < MAX_SHORTFALL_NATS:
            return replace(belief, possible=False)
        return replace(belief, measurements=measurements, posterior=posterior)

    def estimate(self, belief: AdaptiveBelief) -> Estimate:
        """Posterior mean (n,), conditional covariance (n, n) and log evidence."""
        if belief.posterior is None and not isinstance(belief.prior, Predicted):
            evidence = belief.log_evidence if belief.possible else -np.inf
            return Estimate(belief.prior.mean, belief.prior.covariance, evidence)
        cells = self._cells(belief)
        _, mean, covariance, _ = cells.moments
        if not is_definite(covariance):
            covariance = covariance + cells.between_points
        return Estimate(mean, covariance, self._evidence(belief, cells) if belief.possible else -np.inf)

    def error(self, belief: AdaptiveBelief) -> float:
        """Numerical error of mean and covariance in deviations, by lattices that did not make them.

        What was off before a move is still off after it, as far as measurements have not made up for it.
        """
        if not belief.possible or (belief.posterior is None and not isinstance(belief.prior, Predicted)):
            return 0.0
        cells, inherited = self._cells(belief), belief.inherited
        if inherited > 0 and belief.posterior is not None and isinstance(belief.prior, Predicted):
            std = np.sqrt(np.diagonal(cells.moments.covariance))
            inherited *= min(1.0, float((std / belief.prior.deviations).max()))
        return float(np.hypot(cells.error, inherited))

    def resultant(self, belief: AdaptiveBelief) -> float:
        """Length of the mean resultant vector of the heading: see `CanTellDirection`.

        Raises:
            NotImplementedError: If the heading is known.
        """
        if self.problem.space.heading is not None:
            raise NotImplementedError("the heading is known")
        if belief.posterior is None and not isinstance(belief.prior, Predicted):
            return resultant_of_draws(self.problem.space, belief.prior)
        return self._cells(belief).moments.resultant

    def sample(self, belief: AdaptiveBelief, size: int, rng: Generator) -> Array:
        """Draws from the belief, (size, n), with the mean and covariance that it claims."""
        if belief.posterior is None and not isinstance(belief.prior, Predicted):
            return belief.prior.sample(size, rng)
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
        if isinstance(prior, Predicted):
            found = replace(found, missed=prior.blur(prior.draws(DRAWS_ASKED)))
        return verified(target, check, found, self._accuracy)

    def _finer(self, belief: AdaptiveBelief, before: Quadrature, control: Array) -> tuple[Lattice, ...]:
        """The modes before a move, with half the steps where walls cut the law of the move.

        A kernel that stands for the points about it blurs what breaks off at a wall.
        """
        target, _ = self._targets(belief.prior, None, belief.measurements)
        edge, level = self._accuracy.edge(self.problem.space.size), before.level - self._accuracy.margin
        where, left = self.problem.space.position_indices, FINE_POINTS_MOVED
        modes: list[Lattice] = []
        for mode in before.modes:
            reach = np.argsort(-np.linalg.norm(mode.basis[where], axis=0))  # axes that go far come first
            most = int(np.log2(max(left / kept_count(mode), 1)))
            axes = np.isin(np.arange(len(reach)), reach[:most])
            if axes.any() and (axes := axes & coarse_axes(mode, self.problem.motion, control)).any():
                with suppress(TooManyCells):
                    limits = Limits(tuple(modes), level, edge, self.most_cells)
                    mode = halved(mode, axes, target.log_density, limits)
            modes.append(mode)
            left -= kept_count(mode)
        return tuple(modes)

    def _targets(
        self, prior: Prior | Predicted, check: Predicted | None, measurements: Array
    ) -> tuple[Target, Target]:
        """The posterior, and the same from the prior that checks it; they share their work."""
        sensor = self.problem.sensor
        if not isinstance(prior, Predicted):
            target = Target(sensor, prior.log_density, measurements)
            return target, target
        target = Target(sensor, prior.log_density, measurements, prior.cost)
        if check is None:
            return target, target
        return target, replace(target, log_prior=check.log_density, log_prior_cost=check.cost)

    @property
    def _accuracy(self) -> Accuracy:
        return Accuracy(self.accuracy, -float(np.log(self.drop)), self.most_cells)

    def _posterior(
        self, prior: Prior | Predicted, check: Predicted | None, measurements: Array
    ) -> Quadrature:
        """Where measurements (U, B) leave the prior.

        Raises:
            TooManyCells: If that takes more work or cells than allowed.
        """
        target, other = self._targets(prior, check, measurements)
        if not isinstance(prior, Predicted):
            found = self._fix(prior, target)
        else:
            try:
                found = self._after_move(prior, target)
            except TooManyCells:
                if check is None:
                    raise
                coarse = self._targets(check, None, measurements)[0]
                found = refined(coarse, self._after_move(check, coarse), self._accuracy)
                return replace(found, missed=np.inf)  # coarser by an unknown amount, rather than no answer
        found = refined(target, found, self._accuracy)
        return verified(target, other, found, self._accuracy) if found.modes else found

    def _fix(self, prior: Prior, target: Target) -> Quadrature:
        """The posterior before any move."""
        precision = np.asarray(np.linalg.inv(prior.covariance), dtype=float)
        beams = len(target.beams)
        share = int((~np.isnan(target.measurements)).sum()) / beams
        found = NOWHERE
        for factor in MARGIN_FACTORS:
            margin = factor * self._accuracy.margin
            boxes, volume = self._boxes(target.measurements, margin)
            if not len(boxes):
                continue
            found = self._search(target, boxes, float(np.log(volume)), precision)
            if found.modes:
                fit = found.level - float(prior.log_density(found.peak[None])[0])
                if target.perfect() - fit + self._accuracy.margin <= share * self.table.limit(beams, margin):
                    break
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

    def _after_move(self, prior: Predicted, target: Target) -> Quadrature:
        """The posterior after a move: from some predicted points, then from those not yet in a mode."""
        found, rough, scores = NOWHERE, replace(target, log_prior=prior.roughly), prior.scores(target)
        likely = replace(target, log_prior=no_prior, log_prior_cost=0.0)
        for _ in range(2):
            guesses, means, precisions = prior.guesses(scores, MAX_GUESSES_PER_PART, found.holds)
            if not len(guesses):
                break
            peaks = climb(rough, guesses, means, precisions)
            peaks = peaks._replace(log_density=target.log_density(peaks.states))
            found = with_lattices(target, peaks, self._accuracy, found)
        draws = prior.draws(DRAWS_ASKED)
        draws = draws._replace(log_mass=draws.log_mass + draw_log_densities(likely, draws.states))
        found = self._completed(target, rough, found, draws, *prior.means_and_precisions())
        return replace(found, missed=found.missed + prior.blur(draws)) if found.modes else found

    def _completed(
        self, target: Target, rough: Target, found: Quadrature, draws: Draws, means: Array, precisions: Array
    ) -> Quadrature:
        """The modes found, and those that draws show where these hold nothing; and what is still not held.

        Args:
            target: The posterior.
            rough: The same with a prior that is quick to work out, for the climb.
            found: Its modes so far.
            draws: Draws that stand for all of it.
            means: Gaussians that stand for the prior near the draws of each part: means (P, n),
            precisions: and inverse covariances, (P, n, n).
        """
        for steps in (*DRAW_STEPS, None):
            left = np.flatnonzero(~found.holds(draws.states) & (draws.log_mass > -np.inf))
            worth = draws.log_mass[left]
            if found.modes:
                worth = worth - found.log_integral + np.log(found.counts(draws.states[left]))
                missed = min(float(np.logaddexp.reduce(worth, initial=-np.inf)), MOST_MISSED_NATS)
                found = replace(found, missed=float(np.exp(missed)))
                if found.missed < MISSED_SHARE * self.accuracy:
                    break
            if steps is None or not len(left) or not target.work.has(SEARCH_SHARE * target.work.limit):
                break
            best = left[np.argsort(-worth, kind="stable")[:DRAWS_FOLLOWED]]
            of = draws.parts[best]
            peaks = climb(rough, draws.states[best], means[of], precisions[of], steps)
            if rough is not target:
                peaks = peaks._replace(log_density=target.log_density(peaks.states))
            found = with_lattices(target, peaks, self._accuracy, found)
        return found

    def _search(self, target: Target, boxes: Array, log_volume: float, precision: Array) -> Quadrature:
        """The modes about the best boxes, and about boxes that are good and in none of these modes.

        A wide posterior has more good boxes than can be followed, and its best mode may hold all the best.
        Boxes that are no good may be so many, or so far off, that they count together.
        """
        mean, scores = self.problem.prior.mean, quick_scores(target, boxes)
        found, left = NOWHERE, np.flatnonzero(scores > -np.inf)
        worth = scores[left]
        for steps in STEPS_BY_ROUND:
            best = left[np.argsort(-worth, kind="stable")[:MAX_BOXES_FOLLOWED]]
            peaks = climb(target, boxes[best], mean, precision, steps)
            found = with_lattices(target, peaks, self._accuracy, found)
            if not found.modes or len(target.beams) > QUICK_BEAMS:
                break
            if target.perfect() - found.level > UNEXPLAINED_NATS:
                break  # a reading that no state explains: where it fits least badly is all there is to say
            left = left[~found.holds(boxes[left])]
            worth, missed = self._worth(target, boxes[left], scores[left], log_volume, found)
            found = replace(found, missed=missed)
            left, worth = left[worth > -np.inf], worth[worth > -np.inf]
            if not len(left) or not target.work.has(SEARCH_SHARE * target.work.limit):
                break
        if len(target.beams) > QUICK_BEAMS or target.perfect() - found.level > UNEXPLAINED_NATS:
            return found
        drawn = replace(target, work=Work(np.inf))
        draws = self._draws_in(boxes[scores > -np.inf], log_volume)
        draws = draws._replace(log_mass=draws.log_mass + draw_log_densities(drawn, draws.states))
        return self._completed(target, target, found, draws, mean[None], precision[None])

    def _draws_in(self, boxes: Array, log_volume: float) -> Draws:
        """Draws spread evenly over boxes (K, n) of such a volume each, the same number in each."""
        each = max(1, round(DRAWS_ASKED / max(len(boxes), 1)))
        states = np.repeat(boxes, each, axis=0)
        space, rng = self.problem.space, np.random.default_rng(0)
        width = np.sqrt(TWO_PI * np.diagonal(self.problem.prior.covariance))
        width[space.position_indices] = self.table.size[:2] / 2
        if "heading" in space.names:
            width[space.names.index("heading")] = self.table.size[2]
        laser = self._moved(states, 1.0) + width * rng.uniform(-0.5, 0.5, states.shape)
        states = space.wrap(self._moved(laser, -1.0))
        log_share = log_volume - np.log(each)
        return Draws(states, np.zeros(len(states), np.int64), np.full(len(states), log_share))

    def _moved(self, states: Array, sign: float) -> Array:
        """States whose place is the laser's, of states (K, n) of the robot: 1; and the reverse: -1."""
        mount, space = self.problem.sensor.mount, self.problem.space
        if not mount.is_off_centre:
            return states
        moved = np.array(states)
        moved[:, space.position_indices] += sign * mount.offset(space.poses(states)[:, 2])
        return moved

    def _worth(
        self, target: Target, boxes: Array, scores: Array, log_volume: float, found: Quadrature
    ) -> tuple[Array, float]:
        """How much boxes (K, n) that no mode holds ask to be followed, (K,), nats; -inf where they need not.

        And by how much mean and covariance are off without them, at most, in deviations.

        Those that score as well as points of the best mode do; and the others, by their density, if the sum
        over them says that together they count: point 6 of docs/theory.md, "Adaptive cells".
        """
        counts = found.counts(boxes)
        perfect, allowed = target.perfect(), MISSED_SHARE * self.accuracy
        good = scores > found.level - perfect - self._accuracy.edge(boxes.shape[1])
        share = np.log(counts) + log_volume - found.log_integral
        # a score is a bound on the density: those left out here add up to less than is allowed
        asked = np.flatnonzero(~good & (scores + perfect + share > np.log(allowed / (1 + len(boxes)))))
        others = np.full(len(boxes), -np.inf)
        others[asked] = target.log_density(boxes[asked])
        missed = float(np.exp(others + share).sum())
        if missed < allowed:
            return np.where(good, scores, -np.inf), missed
        return np.where(good, scores, others + np.log(counts) - perfect), missed

    def _boxes(self, measurements: Array, margin: float) -> tuple[Array, float]:
        """States (K, n) at the centres of the boxes that may hold the true one, and the volume of each.

        Where there are too many, some are drawn, and stand for all.
        """
        table, space = self.table, self.problem.space
        bounds = sum(
            shortfall_bounds(table, self.problem.sensor, measurement, margin) for measurement in measurements
        )
        assert isinstance(bounds, np.ndarray)
        possible = kept = np.flatnonzero(np.isfinite(bounds))
        if len(kept) > MAX_BOXES:
            lots = LOT_NATS * np.random.default_rng(0).gumbel(size=len(kept))
            kept = kept[np.argpartition(bounds.ravel()[kept] - lots, MAX_BOXES)[:MAX_BOXES]]
        cells, headings = np.divmod(kept, bounds.shape[1])
        quarter = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)]) * table.size[:2]
        whole = table.whole[cells]
        centres = np.concatenate(
            [(table.centres[cells[whole], None] + quarter).reshape(-1, 2), table.centres[cells[~whole]]]
        )
        states = np.tile(self.problem.prior.mean, (len(centres), 1))
        states[:, space.position_indices] = centres
        wide = TWO_PI * np.diagonal(self.problem.prior.covariance)  # velocities, as wide as their prior
        volume = np.sqrt(
            np.prod([wide[i] for i, name in enumerate(space.names) if name not in BOX_COMPONENTS])
        )
        if "heading" in space.names:
            angles = table.headings[np.concatenate([np.repeat(headings[whole], 4), headings[~whole]])]
            states[:, space.names.index("heading")] = angles
        states = self._moved(states, -1.0)
        quarters = np.where(table.whole[possible // len(table.headings)], 4, 1).sum()
        volume *= np.prod(table.size[:2] / 2) * (table.size[2] or 1.0)
        return states, float(volume * quarters / max(len(states), 1))


def draw_log_densities(target: Target, states: Array) -> Array:
    """Log densities of drawn states, (J, n) -> (J,); with many beams -inf for all but the likeliest."""
    few, logs = target.few(GUESS_BEAMS), np.full(len(states), -np.inf)
    first = few.log_density(states)
    if few is target:
        return first
    best = np.argsort(-first, kind="stable")[:MAX_BOXES_FOLLOWED]
    logs[best] = target.log_density(states[best])
    return logs


def no_prior(states: Array) -> Array:
    """A log density of zero everywhere, (K, n) -> (K,)."""
    return np.zeros(len(states))


def resultant_of_draws(space: StateSpace, prior: Prior) -> float:
    """Length of the mean resultant vector of a prior's heading."""
    headings = prior.sample(PRIOR_DRAWS, np.random.default_rng(0))[:, space.names.index("heading")]
    return float(np.abs(np.exp(1j * headings).mean()))


def check_options(accuracy: float, drop: float, table_rays: int, most_cells: int) -> None:
    """Refuse options that are out of bounds.

    Raises:
        ValueError: If one is.
    """
    if not 1e-4 <= accuracy <= 0.5:
        raise ValueError(f"the accuracy must be in [0.0001, 0.5], got {accuracy}")
    if not 0 < drop < 1e-2:
        raise ValueError(f"the dropped density must be in (0, 0.01), got {drop}")
    if table_rays < 1000 or most_cells < 1000:
        raise ValueError("need at least 1000 rays for the table and 1000 cells")


def _joined(measurements: Array, fresh: Array) -> Array:
    """Measurements (U, B) with one more, in the first row whose beams it does not repeat."""
    for row, measurement in enumerate(measurements):
        if not (~np.isnan(measurement) & ~np.isnan(fresh)).any():
            joined = measurements.copy()
            joined[row] = np.where(np.isnan(fresh), measurement, fresh)
            return joined
    return np.vstack([measurements, fresh])
