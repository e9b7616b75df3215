"""The same work done by JAX and by libraries on top of it, each in the leanest way that we found.

All is jitted and in float64. What is known beforehand (ranges of the cells, ranges in closed form, the model)
is compiled in; readings lie ready in JAX's arrays, and answers stay in them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from .peers import room_beams

jax.config.update("jax_enable_x64", True)

LOG_TWO_PI = float(np.log(2 * np.pi))
BATCH = 8  # runs at a time of `lax.map`: 1 MB of weights, which stay in the cache


def ready(call, *arguments):
    """A function that calls and waits for the answer."""
    return lambda: jax.block_until_ready(call(*arguments))


def point_mass(ranges, axes, std):
    """Reading (B,) to mean, covariance and log evidence, on cells in rows and columns.

    ranges (B, *shape), axes: places of the rows and of the columns. Beams are summed in one expression, for a
    sum over an axis of three takes three times as long; squares are expanded, so that those of the ranges are
    ready; moments are matrix products along one axis, then along the other.
    """
    ranges = [jnp.asarray(each) for each in ranges]
    scale = 1 / std**2
    squares = 0.5 * scale * sum(each * each for each in ranges)
    middle = np.array([axis.mean() for axis in axes])
    powers = [
        np.stack([(axis - at) ** power for power in range(3)]) for axis, at in zip(axes, middle, strict=True)
    ]
    rows, columns = jnp.asarray(powers[0]), jnp.asarray(powers[1].T)
    constant = -0.5 * len(ranges) * (LOG_TWO_PI + 2 * np.log(std)) - np.log(ranges[0].size)

    def update(reading):
        logs = sum(each * (scale * value) for each, value in zip(ranges, reading, strict=True)) - squares
        greatest = logs.max()
        sums = rows @ (jnp.exp(logs - greatest) @ columns)
        total, sums = sums[0, 0], sums / sums[0, 0]
        mean = jnp.stack([sums[1, 0], sums[0, 1]])
        second = jnp.stack([jnp.stack([sums[2, 0], sums[1, 1]]), jnp.stack([sums[1, 1], sums[0, 2]])])
        evidence = jnp.log(total) + greatest - 0.5 * scale * (reading @ reading) + constant
        return mean + middle, second - jnp.outer(mean, mean), evidence

    return update


def all_runs(update):
    """Ways to update all runs, by name: readings (M, B) to moments and log evidences of all."""
    return {
        "JAX, lax.map": jax.jit(lambda readings: jax.lax.map(update, readings)),
        f"JAX, lax.map by {BATCH}": jax.jit(lambda readings: jax.lax.map(update, readings, batch_size=BATCH)),
        "JAX, vmap": jax.jit(jax.vmap(update)),
    }


def _log_likelihood(place, reading, std):
    """Of a place, or of as many as there are, up to a constant."""
    return sum(
        -0.5 * ((value - beam) / std) ** 2
        for value, beam in zip(reading, room_beams(*place, jnp), strict=True)
    )


def _key(seed):
    """Of the fastest generator: the filters draw a key for each particle that does not move."""
    return jax.random.key(seed, impl="unsafe_rbg")


class Cuthbert:
    """The particle filter of cuthbert, with systematic resampling.

    Args:
        cloud: Where the particles start, (N, 2).
        std: Of the readings.
        below: Resample where fewer than this fraction of the particles count; None = at every step.
    """

    def __init__(self, cloud, std, below):
        from cuthbert.smc import particle_filter
        from cuthbertlib.resampling import adaptive, systematic

        places, key = tuple(jnp.asarray(each) for each in cloud.T), _key(1)
        resampling = (
            systematic.resampling if below is None else adaptive.ess_decorator(systematic.resampling, below)
        )
        peer = particle_filter.build_filter(
            init_sample=lambda key: tuple(each[0] for each in places),
            propagate_sample=lambda key, place, reading: place,
            log_potential=lambda before, place, reading: _log_likelihood(place, reading, std),
            n_filter_particles=len(cloud),
            resampling_fn=resampling,
        )
        self.start = peer.init_prepare(key=_key(0))._replace(particles=places, model_inputs=jnp.zeros(3))
        self._step = jax.jit(
            lambda state, reading: peer.filter_combine(state, peer.filter_prepare(reading, key=key))
        )

    def step(self, state, reading):
        return self._step(state, reading)

    def weighted(self, state):
        """States (2, N) and weights that sum to one."""
        logs = np.asarray(state.log_weights)
        weights = np.exp(logs - logs.max())
        return np.array(state.particles), weights / weights.sum()


class Blackjax:
    """The general step of blackjax's SMC with its systematic resampling, which it does at every step."""

    def __init__(self, cloud, std):
        from blackjax.smc import base, resampling

        places, key = tuple(jnp.asarray(each) for each in cloud.T), _key(1)

        def step(state, reading):
            after, info = base.step(
                key,
                state,
                lambda keys, places, options: (places, None),
                lambda places: _log_likelihood(places, reading, std),
                resampling.systematic,
            )
            return after, info.log_likelihood_increment

        self.start, self._step = base.init(places, ()), jax.jit(step)

    def step(self, state, reading):
        return self._step(state, reading)[0]

    def weighted(self, state):
        """States (2, N) and weights that sum to one."""
        return np.array(state.particles), np.asarray(state.weights)


def _log_normal(rest, variance):
    return -0.5 * (rest * rest / variance + jnp.log(variance) + LOG_TWO_PI)


def _one_beam(beam):
    """The emission function of dynamax for one beam."""
    return lambda state, _: room_beams(state[0], state[1], jnp)[beam][None]


def dynamax_beam_by_beam(kind, prior, std):
    """Beam after beam by the step of dynamax that conditions on a reading, `_condition_on`; readings (M, 3).

    The public filters take one emission function for all times. That of the EKF gives no log evidence: it is
    written as dynamax's own filter has it.
    """
    from dynamax.nonlinear_gaussian_ssm import inference_ekf, inference_ukf

    start, noise = (jnp.asarray(prior.mean), jnp.asarray(prior.covariance)), jnp.eye(1) * std**2
    spread = inference_ukf._compute_lambda(1.0, 0.0, 2)
    weights = inference_ukf._compute_weights(2, 1.0, 2.0, spread)

    def extended(state, covariance, beam, reading):
        emission = _one_beam(beam)
        slope = jax.jacfwd(emission)
        across = slope(state, None)
        rest = reading - emission(state, None)
        density = _log_normal(rest, across @ covariance @ across.T + noise).sum()
        after = inference_ekf._condition_on(state, covariance, emission, slope, noise, None, reading, 1)
        return density, *after

    def unscented(state, covariance, beam, reading):
        nothing = jnp.zeros(1)
        return inference_ukf._condition_on(
            state, covariance, _one_beam(beam), noise, spread, *weights, nothing, reading
        )

    condition = {"ekf": extended, "ukf": unscented}[kind]

    def run(reading):
        (state, covariance), evidence = start, 0.0
        for beam in range(3):
            density, state, covariance = condition(state, covariance, beam, reading[beam, None])
            evidence += density
        return state, covariance, evidence

    return jax.jit(jax.vmap(run))


def dynamax_filter(kind, prior, std):
    """The `extended_kalman_filter` or `unscented_kalman_filter` of dynamax; readings (M, T, 3)."""
    from dynamax.nonlinear_gaussian_ssm import inference_ekf, inference_ukf
    from dynamax.nonlinear_gaussian_ssm.models import ParamsNLGSSM

    model = ParamsNLGSSM(
        initial_mean=jnp.asarray(prior.mean),
        initial_covariance=jnp.asarray(prior.covariance),
        dynamics_function=lambda state: state,
        dynamics_covariance=jnp.zeros((2, 2)),
        emission_function=lambda state: jnp.stack(room_beams(state[0], state[1], jnp)),
        emission_covariance=jnp.eye(3) * std**2,
    )
    wanted = ["filtered_means", "filtered_covariances"]
    points = inference_ukf.UKFHyperParams(alpha=1.0, beta=2.0, kappa=0.0)

    def run(readings):
        if kind == "ekf":
            found = inference_ekf.extended_kalman_filter(model, readings, output_fields=wanted)
        else:
            found = inference_ukf.unscented_kalman_filter(model, readings, points, output_fields=wanted)
        return found.filtered_means[-1], found.filtered_covariances[-1], found.marginal_loglik

    return jax.jit(jax.vmap(run))


def by_hand(kind, prior, std):
    """An EKF or UKF of two components written out for this room, beam after beam; readings (M, 3).

    All runs are one array for each number of the state, so that XLA makes a single loop of the whole.
    """
    start, spread = np.asarray(prior.mean), np.asarray(prior.covariance)

    def extended(x, y, xx, xy, yy, beam):
        def look(x, y):
            return room_beams(x, y, jnp)[beam]

        ones, zeros = jnp.ones_like(x), jnp.zeros_like(x)
        expected, along = jax.jvp(look, (x, y), (ones, zeros))
        _, across = jax.jvp(look, (x, y), (zeros, ones))
        cross = xx * along + xy * across, xy * along + yy * across
        return expected, cross, along * cross[0] + across * cross[1]

    def unscented(x, y, xx, xy, yy, beam):
        reach = np.sqrt(2.0)  # alpha = 1, beta = 2, kappa = 0, as ours and dynamax's
        side = jnp.sqrt(xx)
        down = xy / side
        root = (side, down), (jnp.zeros_like(x), jnp.sqrt(yy - down * down))
        arms = [(sign * reach * a, sign * reach * b) for a, b in root for sign in (1, -1)]
        seen = [room_beams(x + a, y + b, jnp)[beam] for a, b in arms]
        expected = 0.25 * sum(seen)
        off = [each - expected for each in seen]
        cross = tuple(
            0.25 * sum(arm[axis] * each for arm, each in zip(arms, off, strict=True)) for axis in (0, 1)
        )
        centre = room_beams(x, y, jnp)[beam] - expected
        return expected, cross, 0.25 * sum(each * each for each in off) + 2 * centre * centre

    look = {"ekf": extended, "ukf": unscented}[kind]

    def run(readings):
        runs = len(readings)
        x, y = (jnp.full(runs, value) for value in start)
        xx, xy, yy = (jnp.full(runs, value) for value in (spread[0, 0], spread[0, 1], spread[1, 1]))
        evidence = jnp.zeros(runs)
        for beam in range(3):
            expected, (a, b), variance = look(x, y, xx, xy, yy, beam)
            variance, rest = variance + std**2, readings[:, beam] - expected
            x, y = x + a / variance * rest, y + b / variance * rest
            xx, xy, yy = xx - a * a / variance, xy - a * b / variance, yy - b * b / variance
            evidence += _log_normal(rest, variance)
        covariance = jnp.stack([jnp.stack([xx, xy], axis=-1), jnp.stack([xy, yy], axis=-1)], axis=-1)
        return jnp.stack([x, y], axis=-1), covariance, evidence

    return jax.jit(run)
