"""The same work done by other libraries, each in its own leanest way.

All get the expected ranges that ours has cached, or the fastest range function that we know, and are set up
before the clock runs.
"""

from __future__ import annotations

import datetime
import warnings

import numpy as np
import pytest

NOW = datetime.datetime(2000, 1, 1)


def needs(module, extra="bench"):
    """Import a peer, or skip."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reason = f"{module} is not installed; it comes with the extra '{extra}'"
        return pytest.importorskip(module, reason=reason)


def moments(points, weights):
    """Mean and covariance of points (n, G) with weights (G,) that sum to one."""
    mean = points @ weights
    deviation = points - mean[:, None]
    return mean, (weights * deviation) @ deviation.T


def numpy_update(ranges, centres, std):
    """Plain numpy, written with care: beam by beam, in place, no exp of what underflows.

    ranges (B, G), centres (n, G) -> a function from a reading (B,) to mean (n,) and covariance (n, n).
    """

    def update(reading):
        logs = np.square(ranges[0] - reading[0])
        for expected, value in zip(ranges[1:], reading[1:], strict=True):
            logs += np.square(expected - value)
        logs *= -0.5 / std**2
        logs -= logs.max()
        weights = np.exp(np.maximum(logs, -700.0, out=logs), out=logs)
        weights /= weights.sum()
        return moments(centres, weights)

    return update


def numpy_broadcast(ranges, centres, std):
    """Plain numpy as the formula reads: (G, B) arrays, one expression."""
    ranges, centres = np.ascontiguousarray(ranges.T), np.ascontiguousarray(centres.T)

    def update(reading):
        logs = -0.5 * (((reading - ranges) / std) ** 2).sum(axis=1)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ centres
        deviation = centres - mean
        return mean, (weights[:, None] * deviation).T @ deviation

    return update


def stonesoup_point_mass(ranges, centres, step, std):
    """Stone Soup's PointMassUpdater; its measurement model hands out the cached ranges."""
    needs("stonesoup")
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import PointMassStatePrediction
    from stonesoup.updater.pointmass import PointMassUpdater

    model = _stonesoup_model(lambda state: ranges, std)
    weight = np.full(centres.shape[1], 1 / (centres.shape[1] * np.prod(step)))
    prior = PointMassStatePrediction(
        state_vector=StateVectors(centres), weight=weight, grid_delta=step, timestamp=NOW
    )
    updater = PointMassUpdater(None)

    def update(reading):
        detection = Detection(StateVector(reading), timestamp=NOW, measurement_model=model)
        posterior = updater.update(SingleHypothesis(prior, detection))
        return np.asarray(posterior.mean), np.asarray(posterior.covar())

    return update


def bayesloop_study(ranges, axes, std):
    """The Study of bayesloop, one time step, forward pass only; numpy works out the covariance.

    ranges (B, *shape), axes: the n marginal grids -> reading to mean, covariance, log evidence.
    """
    needs("bayesloop")
    import bayesloop

    scale = (2 * np.pi * std**2) ** (-0.5 * len(ranges))

    def likelihood(data, x1, x2):
        total = np.square(ranges[0] - data[0])
        for expected, value in zip(ranges[1:], data[1:], strict=True):
            total += np.square(expected - value)
        total *= -0.5 / std**2
        np.exp(np.maximum(total, -700.0, out=total), out=total)
        total *= scale
        return total

    study = bayesloop.Study(silent=True)
    model = bayesloop.om.NumPy(likelihood, "x1", axes[0], "x2", axes[1])
    study.set(model, bayesloop.tm.Static(), silent=True)
    points = np.stack([axis.ravel() for axis in study.grid])

    def update(reading):
        study.load_data(reading[None], silent=True)
        study.fit(forward_only=True, silent=True)
        mean = study.posterior_mean_values[:, 0]
        deviation = points - mean[:, None]
        covariance = (study.posterior_sequence[0].ravel() * deviation) @ deviation.T
        return mean, covariance, study.log_evidence

    return update


def room_beams(x, y, arrays=np):
    """The three beams of the paper from (x, y), in closed form: the walls that they can meet only.

    arrays: numpy, or what has the same names.
    """
    along, across = 1 / np.sin(np.deg2rad(33.7)), 1 / np.cos(np.deg2rad(33.7))
    ahead = 6.0 - y
    aslant = ahead * across
    return arrays.minimum(x * along, aslant), ahead, arrays.minimum((4.0 - x) * along, aslant)


def room_ranges(states):
    """The same from states (2, N)."""
    return room_beams(states[0], states[1])


def particles_filter(cloud, readings, std):
    """The package `particles`: SMC over a Feynman-Kac model that starts from the cloud (N, 2) and stays.

    Returns a function that makes a fresh one; each `next` of it takes in a reading, after systematic
    resampling where the effective number is below half.
    """
    particles = needs("particles")

    class Model(particles.FeynmanKac):
        def M0(self, size):
            return cloud

        def M(self, time, states):
            return states

        def logG(self, time, before, states):
            total = 0.0
            for reading, expected in zip(readings[time], room_ranges(states.T), strict=True):
                total = total - 0.5 * ((reading - expected) / std) ** 2
            return total

    def fresh(steps=0):
        peer = particles.SMC(
            Model(T=len(readings)), N=len(cloud), resampling="systematic", ESSrmin=0.5, collect="off"
        )
        for _ in range(steps):
            next(peer)
        return peer

    return fresh


def stonesoup_particle(cloud, std):
    """Stone Soup's ParticleUpdater, systematic resampling after the first of two readings."""
    needs("stonesoup")
    from stonesoup.resampler.particle import ESSResampler
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import ParticleStatePrediction
    from stonesoup.updater.particle import ParticleUpdater

    model = _stonesoup_model(lambda state: np.array(room_ranges(np.asarray(state.state_vector))), std)
    prior = ParticleStatePrediction(
        StateVectors(cloud.T), log_weight=np.full(len(cloud), -np.log(len(cloud))), timestamp=NOW
    )
    resampling, weighing = ParticleUpdater(None, resampler=ESSResampler()), ParticleUpdater(None)

    def step(updater, state, reading):
        detection = Detection(StateVector(reading), timestamp=NOW, measurement_model=model)
        return updater.update(SingleHypothesis(state, detection))

    def update(readings):
        """States (2, N) and weights after two readings."""
        posterior = step(weighing, step(resampling, prior, readings[0]), readings[1])
        return np.asarray(posterior.state_vector), np.exp(posterior.log_weight)

    return update


def _stonesoup_model(expected, std):
    """A Gaussian measurement model of three beams around expected(state), (3, N)."""
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement

    class Beams(NonLinearGaussianMeasurement):
        @property
        def ndim_meas(self):
            return 3

        def function(self, state, noise=False, **others):
            return expected(state)

    return Beams(ndim_state=2, mapping=(0, 1), noise_covar=np.eye(3) * std**2)
