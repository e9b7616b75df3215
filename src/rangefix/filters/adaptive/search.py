"""Where the posterior of the adaptive filter may be: the search for its modes, before and after a move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import TWO_PI, Array, IntArray
from ..problem import Prior, Problem
from .gauss_newton import QUICK_BEAMS, STEPS, Peaks, box_scores, climb, quick_scores
from .lattices.quadrature import NOWHERE, Accuracy, Quadrature
from .modes import SEARCH_SHARE, with_lattices
from .prediction.predicted import GUESS_BEAMS, Draws, Predicted
from .range_bounds import shortfall_bounds
from .range_table import SearchTable
from .target import Target, Work

MARGIN_FACTORS = (1.0, 10.0, 100.0, np.inf)  # readings that fit nowhere are looked for more widely
MAX_BOXES = 20_000  # that a search may leave
SCORED_RAYS = 1_000_000  # by which boxes are asked how much they may hold
BEAMS_IN_TURN = ((8, 16), (GUESS_BEAMS, GUESS_BEAMS + 1))  # that are asked first, of so many at least
NOTHING = 1e-5  # deviations that draws may be off by, all together, which are left out by that
LIKELY_BOXES = 2500  # that may hold most, which are followed and have more draws
DRAWS_IN_LIKELY = 16  # of the draws that show what is missed
LOT_NATS = 3.0  # by which those that are left then are drawn by lot
MAX_BOXES_FOLLOWED = 2000  # at once
STEPS_BY_ROUND = (STEPS, STEPS, 0, STEPS, 0)  # without steps, guesses that lead elsewhere count too
MOST_MISSED_NATS = 700.0  # more is as much: nothing of what counts has been found yet
MISSED_SHARE = 0.25  # of the accuracy: how much boxes may count that are not followed
BOX_COMPONENTS = ("x1", "x2", "heading")
DRAWS_ASKED, AT_ERROR = 20_000, 0.02  # that show what the modes found hold nothing of; of larger errors fewer
DRAWS_FOLLOWED = 48  # of those, at once
FEW_HELD = 10  # draws in the modes found: a mode as wide could be between draws
DRAWS_SCORED, DRAWS_CLIMBED = 2000, 200
DRAW_STEPS = (STEPS, 0, 0)  # of the climb from them, round by round
MAX_GUESSES_PER_PART = 24  # points of a predicted mode that are followed
HOPELESS_NATS = 1e7  # short of a perfect fit by the best middles of boxes: no other box will do
UNEXPLAINED_NATS = 1000.0  # short of a perfect fit, from where on no further modes are looked for


@dataclass
class Survey:
    """Draws that stand for all of a posterior, by which to tell what its lattices do not hold.

    Only draws that no lattice holds are asked for their density, each of them once.

    Attributes:
        draws: With what each stands for before it was asked, log.
        target: What multiplies that: with many beams, 0 for all but the likeliest.
        rough: The posterior with a prior that is quick to work out, for the climb from them.
        means, precisions: Gaussians that stand for the prior near the draws of each part, (P, n) and
            inverse covariances, (P, n, n).
        blur: What kernels of the prior blur beside, in deviations.
    """

    draws: Draws
    target: Target
    rough: Target
    means: Array
    precisions: Array
    blur: float = 0.0

    def __post_init__(self) -> None:
        self._logs = np.full(len(self.draws.states), np.nan)

    def log_mass(self, which: IntArray, found: Quadrature = NOWHERE) -> Array:
        """Log of what some draws stand for, (k,); -inf of what counts for nothing beside what is found."""
        new = which[np.isnan(self._logs[which])]
        if len(new):
            states, bars = self.draws.states[new], np.full(len(new), -np.inf)
            if found.modes:
                bars = found.log_integral - np.log(found.counts(states)) - self.draws.log_mass[new]
                bars += np.log(NOTHING / len(self._logs))
            self._logs[new] = draw_log_densities(self.target, states, bars)
        return np.asarray(self.draws.log_mass[which] + self._logs[which])

    def missed(self, found: Quadrature) -> float:
        """By how much mean and covariance are off for what no lattice holds, in deviations."""
        return self.blur + _summed(self.worth(found, self.unheld(found)))

    def unheld(self, found: Quadrature) -> IntArray:
        """Which draws lie in no cell, and count, (k,)."""
        left = np.flatnonzero(~found.holds(self.draws.states))
        return left[self.log_mass(left, found) > -np.inf]

    def worth(self, found: Quadrature, left: IntArray) -> Array:
        """How much those draws count, log, (k,)."""
        worth = self.log_mass(left)
        if not found.modes:
            return worth
        return np.asarray(worth - found.log_integral + np.log(found.counts(self.draws.states[left])))


@dataclass(frozen=True)
class ModeSearch:
    """How modes are found: from the boxes of a table before any move, from predicted points after one.

    Attributes:
        problem: Whose map, sensor and prior.
        table: Bounds of the ranges from the coarse cells of the prior's support.
        accuracy: How little a mode may count that is not looked for.
    """

    problem: Problem
    table: SearchTable
    accuracy: Accuracy

    @property
    def draws_asked(self) -> int:
        """So many that what may just be missed of the posterior holds as many of them at every accuracy."""
        return round(DRAWS_ASKED * min(1.0, AT_ERROR / self.accuracy.error))

    def fix(self, prior: Prior, target: Target) -> tuple[Quadrature, Survey | None]:
        """The posterior before any move, and draws that tell what it misses; none with many beams."""
        precision = np.asarray(np.linalg.inv(prior.covariance), dtype=float)
        beams = len(target.beams)
        share = int((~np.isnan(target.measurements)).sum()) / beams
        found, survey = NOWHERE, None
        for factor in MARGIN_FACTORS:
            margin = factor * self.accuracy.margin
            boxes, volume = self._boxes(target.measurements, margin)
            if not len(boxes):
                continue
            found, survey = self._search(target, boxes, float(np.log(volume)), precision)
            if found.modes:
                fit = found.level - float(prior.log_density(found.peak[None])[0])
                if target.perfect() - fit + self.accuracy.margin <= share * self.table.limit(beams, margin):
                    break
        return found, survey

    def after_move(self, prior: Predicted, target: Target) -> tuple[Quadrature, Survey]:
        """The posterior after a move: from some predicted points, then from those not yet in a mode."""
        found, rough, scores = NOWHERE, replace(target, log_prior=prior.roughly), prior.scores(target)
        likely = replace(target, log_prior=no_prior, log_prior_cost=0.0)
        for _ in range(2):
            guesses, means, precisions = prior.guesses(scores, MAX_GUESSES_PER_PART, found.holds)
            if not len(guesses):
                break
            way = target, rough, guesses, means, precisions
            peaks = climbed(*way)
            if target.perfect() - peaks.log_density.max() > UNEXPLAINED_NATS:
                peaks = both(peaks, climbed(*way, trimmed=False))
            found = with_lattices(target, peaks, self.accuracy, found)
        draws = prior.draws(self.draws_asked)
        survey = Survey(draws, likely, rough, *prior.means_and_precisions())
        if prior.is_blurred:
            survey.blur = prior.blur(draws.parts, survey.log_mass(np.arange(len(draws.parts))))
        if found.holds(draws.states).sum() < FEW_HELD:
            found = self._between_draws(target, found, survey)
        return self.completed(target, found, survey), survey

    def _between_draws(self, target: Target, found: Quadrature, survey: Survey) -> Quadrature:
        """The modes found, and those between draws that lie too far apart to be in any."""
        some = np.arange(0, len(survey.draws.states), -(-len(survey.draws.states) // DRAWS_SCORED))
        some = some[~found.holds(survey.draws.states[some])]
        if not len(some):
            return found
        states, of = survey.draws.states[some], survey.draws.parts[some]
        boxes = survey.precisions[of] * len(some) ** (2 / states.shape[1])
        few = survey.target.few(GUESS_BEAMS)
        best = np.argsort(-box_scores(few, states, boxes), kind="stable")[:DRAWS_CLIMBED]
        of = of[best]
        way = target, survey.rough, states[best], survey.means[of], survey.precisions[of]
        peaks = both(climbed(*way), climbed(*way, trimmed=False))
        return with_lattices(target, peaks, self.accuracy, found)

    def completed(self, target: Target, found: Quadrature, survey: Survey) -> Quadrature:
        """The modes found, and those that draws show where these hold nothing; and what is still not held."""
        draws, rough = survey.draws, survey.rough
        for steps in (*DRAW_STEPS, None):
            left = survey.unheld(found)
            worth = survey.worth(found, left)
            if found.modes:
                missed = _summed(worth)
                found = replace(found, missed=missed + survey.blur)
                if missed < MISSED_SHARE * self.accuracy.error:
                    break
            if steps is None or not len(left) or not target.work.has(SEARCH_SHARE * target.work.limit):
                break
            best = left[np.argsort(-worth, kind="stable")[:DRAWS_FOLLOWED]]
            of = draws.parts[best]
            peaks = climb(rough, draws.states[best], survey.means[of], survey.precisions[of], steps)
            if rough is not target:
                peaks = peaks._replace(log_density=target.log_density(peaks.states))
            found = with_lattices(target, peaks, self.accuracy, found)
        return found

    def _search(
        self, target: Target, boxes: Array, log_volume: float, precision: Array
    ) -> tuple[Quadrature, Survey | None]:
        """The modes about the best boxes, and about boxes that are good and in none of these modes.

        A wide posterior has more good boxes than can be followed, and its best mode may hold all the best.
        Boxes that are no good may be so many, or so far off, that they count together.
        """
        mean, scores = self.problem.prior.mean, quick_scores(target, boxes)
        found, left = NOWHERE, np.flatnonzero(scores > -np.inf)
        worth, likely = scores[left], None
        for steps in STEPS_BY_ROUND:
            best = left[np.argsort(-worth, kind="stable")[:MAX_BOXES_FOLLOWED]]
            peaks = climb(target, boxes[best], mean, precision, steps)
            found = with_lattices(target, peaks, self.accuracy, found)
            if not found.modes or len(target.beams) > QUICK_BEAMS:
                break
            if likely is None and target.perfect() - found.level < HOPELESS_NATS:
                likely = self._likely(target, boxes, scores)
                if len(likely):
                    peaks = climb(target, boxes[likely], mean, precision, steps)
                    found = with_lattices(target, peaks, self.accuracy, found)
            if target.perfect() - found.level > UNEXPLAINED_NATS:
                break  # a reading that no state explains: where it fits least badly is all there is to say
            left = left[~found.holds(boxes[left])]
            worth, missed = self._worth(target, boxes[left], scores[left], log_volume, found)
            found = replace(found, missed=missed)
            left, worth = left[worth > -np.inf], worth[worth > -np.inf]
            if not len(left) or not target.work.has(SEARCH_SHARE * target.work.limit):
                break
        if len(target.beams) > QUICK_BEAMS or target.perfect() - found.level > UNEXPLAINED_NATS:
            return found, None
        drawn = replace(target, work=Work(np.inf))
        each = np.ones(len(boxes), dtype=np.int64)
        if likely is not None:
            each[likely] = DRAWS_IN_LIKELY
        draws = self._draws_in(boxes, each * (scores > -np.inf), log_volume)
        survey = Survey(draws, drawn, target, mean[None], precision[None])
        return self.completed(target, found, survey), survey

    def _likely(self, target: Target, boxes: Array, scores: Array) -> IntArray:
        """Which boxes (K, n) may hold most of the posterior, of those with the best scores, (k,).

        None where all are followed anyway. Middles of boxes wider than a mode fit as badly in those that hold
        one as in others.
        """
        few = target.few(QUICK_BEAMS)
        asked = np.argsort(-scores, kind="stable")[: SCORED_RAYS // max(len(few.beams), 1)]
        asked = asked[scores[asked] > -np.inf]
        if len(asked) <= MAX_BOXES_FOLLOWED:
            return asked[:0]
        variances = np.diagonal(self.problem.prior.covariance).copy()
        space = self.problem.space
        variances[space.position_indices] = (self.table.size[:2] / 2) ** 2 / 12
        if "heading" in space.names:
            variances[space.names.index("heading")] = self.table.size[2] ** 2 / 12
        likely = box_scores(few, boxes[asked], np.diag(1 / variances))
        return asked[np.argsort(-likely, kind="stable")[:LIKELY_BOXES]]

    def _draws_in(self, boxes: Array, each: IntArray, log_volume: float) -> Draws:
        """Draws spread evenly over boxes (K, n) of such a volume each; in each at least so many, (K,)."""
        each = each * max(1, round(self.draws_asked / max(len(boxes), 1)))
        states = np.repeat(boxes, each, axis=0)
        space, rng = self.problem.space, np.random.default_rng(0)
        width = np.sqrt(TWO_PI * np.diagonal(self.problem.prior.covariance))
        width[space.position_indices] = self.table.size[:2] / 2
        if "heading" in space.names:
            width[space.names.index("heading")] = self.table.size[2]
        laser = self._moved(states, 1.0) + width * rng.uniform(-0.5, 0.5, states.shape)
        states = space.wrap(self._moved(laser, -1.0))
        log_share = log_volume - np.log(np.repeat(each, each))
        return Draws(states, np.zeros(len(states), np.int64), log_share)

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
        perfect, allowed = target.perfect(), MISSED_SHARE * self.accuracy.error
        good = scores > found.level - perfect - self.accuracy.edge(boxes.shape[1])
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


def climbed(
    target: Target, rough: Target, states: Array, means: Array, precisions: Array, trimmed: bool = True
) -> Peaks:
    """Peaks of a climb by a rough target, with densities of the target itself.

    Steps that are not trimmed fit all beams. What fits most of them may be far from what fits all: noise may
    be much wider than readings tell, along a line that few beams look.
    """
    peaks = climb(rough, states, means, precisions, trimmed=trimmed)
    return peaks._replace(log_density=target.log_density(peaks.states))


def both(one: Peaks, other: Peaks) -> Peaks:
    """Peaks of two climbs."""
    return Peaks(*map(np.concatenate, zip(one, other, strict=True)))


def _summed(worth: Array) -> float:
    """The sum of numbers given by their logs, (k,)."""
    return float(np.exp(min(float(np.logaddexp.reduce(worth, initial=-np.inf)), MOST_MISSED_NATS)))


def draw_log_densities(target: Target, states: Array, bars: Array) -> Array:
    """Log densities of drawn states, (J, n) -> (J,); -inf where below bars, (J,), or beyond the likeliest.

    Some beams tell first of which states even a perfect fit of all others would be below its bar.
    """
    left, logs, beams = np.arange(len(states)), np.full(len(states), -np.inf), len(target.beams)
    for most, least in BEAMS_IN_TURN:
        if beams >= least:
            few = target.few(most)
            first = few.log_density(states[left])
            may_count = np.flatnonzero(first + target.perfect() - few.perfect() > bars[left])
            if beams > GUESS_BEAMS == most:
                may_count = may_count[np.argsort(-first[may_count], kind="stable")[:MAX_BOXES_FOLLOWED]]
            left = left[may_count]
    logs[left] = target.log_density(states[left])
    return logs


def no_prior(states: Array) -> Array:
    """A log density of zero everywhere, (K, n) -> (K,)."""
    return np.zeros(len(states))
