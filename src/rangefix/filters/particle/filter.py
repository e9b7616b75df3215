"""The bootstrap particle filter (Gordon, Salmond and Smith, 1993), with moves for what stands still.

Estimates come from the weights before resampling, which only adds noise: particles are resampled at the start
of the next step, and only if their effective number is low.

An object that stands still draws no noise that could tell copies apart. Copies are then moved by Metropolis
steps on its exact posterior, the prior times the likelihood of all readings so far (Gilks and Berzuini, 2001;
Chopin, 2002), so that the claimed covariance is right whatever the shape of the posterior. A reading that
would leave few effective particles is taken in by stages (tempering), with such steps in between: the first
at an open heading, which leaves many modes, by four times as many particles; and one that fits nowhere among
them once more, from the prior, by eight times as many. An object that moves before its first reading is drawn
from the prior then, and moved anew (first_moves.py). Once it has moved and been seen, the steps are those of
its last move (last_step.py). The kernel of Musso, Oudjane and Le Gland (2001) is there too; it blurs whatever
is thinner than its own covariance, as a ring or two modes are, and comes in unasked only where hardly any
particle of an object that moves differs from another, as against a wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..estimate import BriefRepr, Estimate
from ..images import image_of_points
from ..measurement import check_measurement, controls_of_runs, count_runs
from ..models.motion import Stationary
from ..optional_methods import Image
from ..prior_ends import BY_CHANCE
from ..problem import Prior, Problem
from ..sampling import weighted_draws
from ..space import is_definite
from .belief import ParticleBelief, collected, joined, stacked
from .first_moves import FirstMoves, one_more
from .kernel_noise import separate_copies
from .last_step import LastStep
from .likelihood import Likelihood
from .metropolis import Posterior, Target
from .number import resized
from .options import DEFAULT_MOVES, DEFAULT_RESAMPLING, check_options
from .resample_move import ResampleMove, even_share
from .resampling import one_in
from .weights import effective_number, effective_places, equal, exp_of

PARTICLES_PER_BLOCK = 1 << 14  # particles at a time: what is worked out in between stays in the cache
SUM_ROUNDING = 1e-12  # of a covariance summed over particles
ONE_PLACE = 1e-12  # of a side of the box of the prior: a smaller spread is rounding
OPEN_HEADING = 0.5  # rad: where its deviation is more, there may be modes at several headings:
MORE_AT_ANY_HEADING = 4  # times as many particles for the first reading there
MORE_WHERE_NONE_FITS = 8  # the same where a reading fits nowhere among them; both fewer where that takes
MOST_RANGES_ANEW = 1e6  # particles times beams, and more
MOST_READINGS_ANEW = 4  # one that fits nowhere after more than these is odd rather than its place missed

Run = tuple[Array, Array, Array | None, float]  # states, log weights, starts of the last move, log evidence


@dataclass(frozen=True, repr=False)
class ParticleFilter(BriefRepr):
    """Particles weighted by the likelihood.

    Args:
        problem: What may be known.
        particles: How many, N; four times as many take in the first reading where the heading is open, if
            they and the beams make no more than a million ranges.
        resample_below: Resample where the effective number of particles falls below this fraction of N.
        resampling: "systematic", "stratified", "residual" or "multinomial".
        regularise: Move copies apart after resampling: by Metropolis steps, or by the kernel if a `bandwidth`
            is given. False is the bootstrap filter.
        bandwidth: Width of the kernel as a multiple of the best for a Gaussian posterior; no kernel unless
            given.
        moves: Metropolis steps after each resampling.
        temper: Take in a measurement in as many stages as keep the effective number up, with Metropolis steps
            in between (Neal, 2001; Del Moral, Doucet and Jasra, 2006); true, wherever there are such steps,
            unless given. False = every measurement in whole, as the plain particle filter does.
        least_particles: Before a move take as few particles as the belief needs (KLD-sampling: Fox, 2003), no
            fewer than these and no more than `particles`, which there are at first; always as many as at
            first unless given.

    Raises:
        ValueError: If an option is out of its range, or would do nothing beside the others.
    """

    problem: Problem
    particles: int = 2000
    resample_below: float = 0.5
    resampling: str = DEFAULT_RESAMPLING
    regularise: bool = True
    bandwidth: float | None = None
    moves: int = DEFAULT_MOVES
    temper: bool | None = None
    least_particles: int | None = None

    def __post_init__(self) -> None:
        check_options(self)

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> ParticleBelief:
        """N draws from the prior for every run, all of equal weight.

        Raises:
            ValueError: If there is no run.
        """
        runs = count_runs(rngs)
        states = np.empty((runs, self.particles, self.problem.space.size))
        for run, rng in enumerate(rngs):
            states[run] = prior.sample(self.particles, rng)
        log_weights = np.broadcast_to(equal(self.particles), states.shape[:2])
        standing = np.ones(runs, dtype=np.bool_)
        return ParticleBelief(states, log_weights, np.zeros(runs), prior, standing, ((),) * runs)

    def predict(self, belief: ParticleBelief, control: Array, rngs: Sequence[Generator]) -> ParticleBelief:
        """Every particle moved with noise of its own; control (k,) shared, or (M, k).

        A move without noise does not resample, and one that leaves all particles where they are changes
        nothing. Walls are the motion's affair: see `Confined`.

        Raises:
            ValueError: If the control is of another shape, or not of real numbers.
        """
        motion = self.problem.motion
        if isinstance(motion, Stationary):
            return belief
        controls = controls_of_runs(control, len(rngs))
        if self._counts_each(rngs):
            runs = zip(belief.split(), controls, rngs, strict=True)
            return joined([self.predict(one, move, [rng]) for one, move, rng in runs])
        pairs = zip(belief.states[:, 0], controls, strict=True)
        noisy = [bool(motion.noise_covariance(state, move).any()) for state, move in pairs]
        if self.least_particles is not None and all(noisy):
            belief = resized(belief, self.problem.space, self.least_particles, self.particles, rngs[0])
        clouds, starts = [], []
        moves = np.zeros(len(rngs), dtype=np.bool_)
        for run, rng in enumerate(rngs):
            states, log_weights = belief.states[run], belief.log_weights[run]
            if noisy[run] and effective_number(log_weights) < self.resample_below * len(states):
                target = self._target(belief, run) if belief.standing[run] else None
                states, *_ = self._resample_move.resampled(states, exp_of(log_weights), target, rng)
                log_weights = equal(len(states))
            moved = motion.sample(states, controls[run], rng)
            moves[run] = noisy[run] or not np.array_equal(moved, states)
            if moves[run] and self.regularise:
                weights = exp_of(log_weights)
                moved, states = separate_copies(moved, states, weights, self.problem, rng)
            clouds.append((moved, log_weights))
            starts.append(states if moves[run] or belief.starts is None else belief.starts[run])
        if not moves.any():
            return collected(belief, clouds)
        if belief.controls is not None:  # a run that stays keeps its last move
            controls = np.where(moves[:, None], controls, belief.controls)
        kept = (np.where(moves[:, None], np.nan, reading) for reading in belief.readings)
        before = zip(belief.unread, moves, controls, strict=True)
        return collected(
            belief,
            clouds,
            standing=belief.standing & ~moves,
            unread=tuple(one_more(done, control) if moved else done for done, moved, control in before),
            readings=() if moves.all() else tuple(kept),
            starts=stacked(starts),
            controls=controls,
        )

    def update(self, belief: ParticleBelief, measurement: Array, rngs: Sequence[Generator]) -> ParticleBelief:
        """Weights times the likelihood of a measurement (M, B); NaN = not measured, inf = no return.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = check_measurement(self.problem.sensor, measurement, len(rngs))
        if self._counts_each(rngs):
            runs = zip(belief.split(), measurement, rngs, strict=True)
            return joined([self.update(one, reading[None], [rng]) for one, reading, rng in runs])
        clouds, starts, gains = [], [], np.empty(len(rngs))
        for run, rng in enumerate(rngs):
            states, log_weights, start, gains[run] = self._update_run(belief, run, measurement[run], rng)
            clouds.append((states, log_weights))
            starts.append(start)
        readings = belief.readings
        if not np.isnan(measurement).all():
            readings = (*readings, np.where(np.isneginf(gains)[:, None], np.nan, measurement))
        kept = belief.starts if belief.starts is None else stacked([s for s in starts if s is not None])
        read = ~np.isnan(measurement).all(axis=1) & np.isfinite(gains)
        unread = tuple(None if told else moves for told, moves in zip(read, belief.unread, strict=True))
        changes = {"log_evidence": belief.log_evidence + gains, "readings": readings, "starts": kept}
        return collected(belief, clouds, unread=unread, **changes)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Weighted mean (M, n) and covariance (M, n, n), and log evidence (M,).

        Where so few particles have all the weight that they lie on a line, what is between particles is
        added: the posterior is narrower than that, and how narrow they cannot tell. Where all lie on one, as
        copies at two places do, as much is added across it; where all are copies of one place, what would
        lie between as many spread evenly over the box of the prior.
        """
        if belief.counts is not None:
            return Estimate(*map(np.concatenate, zip(*map(self.estimate, belief.split()), strict=True)))
        space, weights = self.problem.space, exp_of(belief.log_weights)
        mean, covariance = space.moments(belief.states, weights)
        lower, upper = belief.prior.support
        rounding = (ONE_PLACE * (upper - lower)) ** 2
        alone = (np.diagonal(covariance, axis1=1, axis2=2) <= rounding).all(axis=1)
        for run in np.flatnonzero(alone | ~is_definite(covariance, SUM_ROUNDING)):
            spacing = self._spacing(belief.states[run])
            if (np.diagonal(spacing) <= rounding).all():
                spacing = np.diag((upper - lower) ** 2 / 12 * even_share(belief.states[run]))
            covariance[run] += spacing
            if not is_definite(covariance[run], SUM_ROUNDING):
                across = np.diagonal(spacing)
                covariance[run] += np.diag(
                    np.where(across > SUM_ROUNDING * across.max(), across, across.max())
                )
        return Estimate(mean, covariance, belief.log_evidence)

    def sample(self, belief: ParticleBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Particles drawn by their weights, (M, size, n): where few have all the weight, copies of those."""
        if belief.counts is not None:
            runs = zip(belief.split(), rngs, strict=True)
            return np.concatenate([self.sample(one, size, [rng]) for one, rng in runs])
        return weighted_draws(belief.states, exp_of(belief.log_weights), size, rngs)

    def density(self, belief: ParticleBelief, run: int) -> Image:
        """A run's weighted particles counted in pixels, for pictures."""
        one = list(belief.split())[run]
        return image_of_points(one.states[0], self.problem, one.log_weights[0])

    def effective_particles(self, belief: ParticleBelief) -> Array:
        """Effective number of particles, (M,), copies at one place counted as one.

        (sum w)^2 / sum w^2 (Kong, Liu and Wong, 1994), w the weights of places and not of particles: copies
        that nothing has moved apart tell no more than one particle does.
        """
        return np.array([effective_places(one.states[0], one.log_weights[0]) for one in belief.split()])

    def resultant(self, belief: ParticleBelief) -> Array:
        """Length of the mean resultant vector of the heading, (M,): see `CanTellDirection`.

        Raises:
            NotImplementedError: If the heading is known.
        """
        if self.problem.space.heading is not None:
            raise NotImplementedError("the heading is known")
        if belief.counts is not None:
            return np.concatenate([self.resultant(one) for one in belief.split()])
        turns = np.exp(1j * belief.states[..., self.problem.space.names.index("heading")])
        return np.asarray(np.abs((np.exp(belief.log_weights) * turns).sum(axis=1)))

    def _counts_each(self, rngs: Sequence[Generator]) -> bool:
        """Whether each of several runs has a number of particles of its own, and is worked on alone."""
        return self.least_particles is not None and len(rngs) > 1

    def _update_run(self, belief: ParticleBelief, run: int, reading: Array, rng: Generator) -> Run:
        """One run's states, log weights, starts of the last move, and log evidence of its reading (B,)."""
        target = self._target(belief, run, reading)
        unread = isinstance(target, LastStep) and belief.unread[run]
        if not (unread or isinstance(target, Posterior)) or self.temper is False or np.isnan(reading).all():
            return self._taken_in(belief, run, reading, target, rng)[0]
        if not isinstance(target, Posterior):
            return self._after_moves(belief, run, reading, rng)
        taken = None
        if (
            not target.readings
            and np.isfinite(belief.log_evidence[run])
            and self._turned_anyhow(belief.prior)
        ):
            taken = self._from_more(belief, run, (), reading, rng, MORE_AT_ANY_HEADING)
        found, best = taken or self._taken_in(belief, run, reading, target, rng)
        if np.isfinite(belief.log_evidence[run] + found[3]) and not self._fits(reading, best):
            taken = self._from_more(belief, run, target.readings, reading, rng, MORE_WHERE_NONE_FITS)
        return taken[0] if taken is not None and taken[0][3] > found[3] else found

    def _turned_anyhow(self, prior: Prior) -> bool:
        """Whether a prior leaves the heading so open that a reading is likely to fit at several."""
        if self.problem.space.heading is not None:
            return False
        place = self.problem.space.names.index("heading")
        return float(prior.covariance[place, place]) > OPEN_HEADING**2

    def _fits(self, reading: Array, best: float) -> bool:
        """Whether a reading is as probable at its best as it is at the truth, but for rare chance."""
        from scipy.special import chdtri  # a tenth of a second

        short = self._usual_likelihood.best(reading) - best
        return bool(short <= chdtri(int((~np.isnan(reading)).sum()), BY_CHANCE) / 2)

    def _from_more(
        self, belief: ParticleBelief, run: int, scans: Sequence[Array], reading: Array, rng: Generator,
        most: int,
    ) -> tuple[Run, float] | None:  # fmt: skip
        """What `_taken_in` gives from the prior anew with up to `most` times as many particles; or None.

        The fewer there are, the more modes of little probability lose all of theirs by chance.
        """
        more = min(most, int(MOST_RANGES_ANEW / (self.particles * len(reading))))
        if more < 2 or len(scans) >= MOST_READINGS_ANEW:
            return None
        wider = replace(self, particles=more * self.particles)
        alone, total = wider.init(belief.prior, [rng]), 0.0
        for scan in (*scans, reading):
            target = wider._target(alone, 0, scan)
            (states, log_weights, _, gain), best = wider._taken_in(alone, 0, scan, target, rng)
            total += gain
            alone = replace(
                alone,
                states=states[None],
                log_weights=log_weights[None],
                readings=(*alone.readings, scan[None]),
            )
        gain = total - float(belief.log_evidence[run])
        if not np.isfinite(gain):
            return None
        ancestors = one_in(more, exp_of(log_weights), rng)
        starts = None if belief.starts is None else belief.starts[run]
        return (states[ancestors], equal(self.particles), starts, gain), best

    def _after_moves(self, belief: ParticleBelief, run: int, reading: Array, rng: Generator) -> Run:
        """The same of the first reading of an object that has moved, by paths anew: see `FirstMoves`."""
        moves = belief.unread[run] or ()
        target = FirstMoves(self.problem, belief.prior, moves, reading)
        count, starts = belief.states.shape[1], None if belief.starts is None else belief.starts[run]
        found: Run = belief.states[run], belief.log_weights[run], starts, -np.inf
        most, usual = int(MOST_RANGES_ANEW / (count * (len(reading) + len(moves)))), 0
        for wanted in (MORE_AT_ANY_HEADING if self._turned_anyhow(belief.prior) else 1, MORE_WHERE_NONE_FITS):
            more = max(1, min(wanted, most))
            if more == usual:
                break
            usual, paths = more, target.paths(more * count, rng)
            paths, log_weights, _, gain, best = self._resample_move.by_stages(
                paths, equal(len(paths)), target, target.log_likelihood, rng
            )
            if gain > found[3]:
                ancestors = one_in(more, exp_of(log_weights), rng)
                _, before, ends = target.parts(paths[ancestors])
                found = ends, equal(count), before, gain
            if self._fits(reading, best):
                break
        return found

    def _taken_in(
        self, belief: ParticleBelief, run: int, reading: Array, target: Target | None, rng: Generator
    ) -> tuple[Run, float]:
        """The same as it comes, and the greatest log density of the reading at a particle."""
        states, log_weights = belief.states[run], belief.log_weights[run]
        unchanged = states, log_weights, None if belief.starts is None else belief.starts[run]
        if np.isnan(reading).all():
            return (*unchanged, 0.0), 0.0
        within = belief.prior if belief.standing[run] and self.bandwidth is None else None
        density = partial(self._log_density, reading, within)
        states, log_weights, target, gain, best = self._resample_move.by_stages(
            states, log_weights, target, density, rng
        )
        if gain == -np.inf:
            return (*unchanged, gain), -np.inf
        starts = target.starts if isinstance(target, LastStep) else unchanged[2]
        return (states, log_weights, starts, gain), best

    def _log_density(self, reading: Array, within: Prior | None, states: Array) -> Array:
        """Log density of a reading at states, (N, n) -> (N,), all of which a prior allows for, or None."""
        total = np.empty(len(states))
        likelihood = Likelihood(self.problem.sensor) if within is None else self._likelihood(within)
        for start in range(0, len(states), PARTICLES_PER_BLOCK):
            part = slice(start, start + PARTICLES_PER_BLOCK)
            total[part] = likelihood.log_densities([reading], states[part])[0]
        return total

    def _likelihood(self, prior: Prior) -> Likelihood:
        """Of the rangefinder at what a prior allows for."""
        usual = prior is self.problem.prior
        return self._usual_likelihood if usual else Likelihood.of(self.problem.sensor, prior)

    @cached_property
    def _usual_likelihood(self) -> Likelihood:
        return Likelihood.of(self.problem.sensor, self.problem.prior)

    def _target(self, belief: ParticleBelief, run: int, fresh: Array | None = None) -> Target | None:
        """What Metropolis steps leave invariant; None where they are not wanted, or not known."""
        if not self.regularise or self.bandwidth is not None:
            return None
        readings = [reading[run] for reading in belief.readings if not np.isnan(reading[run]).all()]
        if belief.standing[run]:
            return Posterior(belief.prior, self._likelihood(belief.prior), readings, fresh)
        if belief.starts is None or belief.controls is None or fresh is None:
            return None
        return LastStep(self.problem, belief.starts[run], belief.controls[run], readings, fresh)

    @cached_property
    def _resample_move(self) -> ResampleMove:
        options = self.regularise, self.bandwidth, self.moves, self.resample_below, self.temper is not False
        return ResampleMove(self.problem, self.resampling, *options)

    def _spacing(self, states: Array) -> Array:
        """What lies between particles (N, n) when they are taken for even: a covariance, (n, n)."""
        _, cloud = self.problem.space.moments(states, np.full(len(states), 1.0 / len(states)))
        return np.asarray(cloud * even_share(states))
