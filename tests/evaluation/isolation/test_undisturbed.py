"""What an estimator does in our own process by accident changes no other's numbers."""

from __future__ import annotations

import random
import warnings
from dataclasses import replace

import numba
import numpy as np
import pytest
import threadpoolctl

from rangefix.evaluation import Experiment, NamedEstimator, run
from rangefix.evaluation.isolation import undisturbed
from rangefix.filters import (
    EachRun,
    Estimate,
    Gaussian,
    GaussianPrior,
    Mixture,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    WithHeading,
    pose_space,
    position_space,
)
from rangefix.maps import RectangularRoom

from ..conftest import PriorOnly, make_problem

ROOM = RectangularRoom(width=4.0, length=6.0)
PLANE = position_space(heading=0.0)
NORTH = Uniform(ROOM, PLANE, lower=[0, 3])
BELL = GaussianPrior([2.0, 3.0], np.eye(2), PLANE, ROOM)


class Sloppy:
    """Moves the mean in place, an array of the prior's own."""

    def init(self, prior, rng):
        return prior.mean, prior.covariance

    def predict(self, belief, control, rng):
        return belief

    def update(self, belief, measurement, rng):
        mean, covariance = belief
        mean += 0.1 * rng.normal(size=2)
        return mean, covariance

    def estimate(self, belief):
        return Estimate(belief[0].copy(), belief[1], 0.0)


class OwnPrior:
    """A prior that hands out the arrays it keeps."""

    def __init__(self):
        self.space, self.mean, self.covariance = PLANE, np.array([2.0, 3.0]), np.diag([16 / 12, 36 / 12])
        self.support = [np.zeros(2), np.array([4.0, 6.0])]

    def sample(self, size, rng):
        return rng.random((size, 2)) * self.support[1]

    def log_density(self, states):
        return np.full(np.shape(states)[:-1], -np.log(24.0))


class Rude(PriorOnly):
    """Sets all that can be set."""

    def __init__(self, problem):
        super().__init__(problem)
        np.seterr(all="ignore", under="raise")

    def update(self, belief, measurement, rngs):
        np.random.seed(0)  # noqa: NPY002
        random.seed(0)
        np.seterr(all="raise")
        numba.set_num_threads(1)
        threadpoolctl.threadpool_limits(1)
        return belief


@pytest.mark.parametrize("prior", [Uniform(ROOM, PLANE), OwnPrior()], ids=["ours", "own"])
@pytest.mark.parametrize("first", ["sloppy", "ekf"])
def test_a_sloppy_estimator_changes_itself_alone(prior, first):
    """Its trials say what it did; the arrays of whoever made the problem stay as they were."""
    problem = replace(make_problem(), prior=prior)
    builders = {"ekf": NamedEstimator("ekf"), "sloppy": lambda problem: EachRun(Sloppy())}
    both = {name: builders[name] for name in sorted(builders, key=lambda name: name != first)}
    kept = prior.mean.copy()
    alone = run(Experiment(problem, {"ekf": builders["ekf"]}, runs=20), timing=False).get("ekf")
    beside = run(Experiment(problem, both, runs=20), timing=False)
    for array in ("mean", "covariance", "log_evidence"):
        assert getattr(alone, array).tobytes() == getattr(beside.get("ekf"), array).tobytes()
    assert "output array is read-only; copy what you write to" in beside.get("sloppy").reasons[0]
    assert (prior.mean == kept).all()
    if isinstance(prior, OwnPrior):
        assert prior.mean.flags.writeable


@pytest.mark.parametrize(
    "prior",
    [
        NORTH,
        BELL,
        GaussianPrior([2.0, 3.0, 0.0], np.eye(3), pose_space()),
        Mixture([NORTH, BELL]),
        Mixture([WithHeading(NORTH, pose_space()), WithHeading(BELL, pose_space(), std=0.1)]),
        WithHeading(BELL, pose_space(), std=0.1),
    ],
    ids=lambda prior: type(prior).__name__,
)
def test_priors_hand_out_what_cannot_be_written_to(prior):
    for array in (prior.mean, prior.covariance, *prior.support):
        with pytest.raises(ValueError, match="read-only"):
            array += 1.0


def test_what_an_estimator_sets_is_restored():
    def states():
        pools = {pool["filepath"]: pool["num_threads"] for pool in threadpoolctl.threadpool_info()}
        return pools, np.geterr(), np.random.get_state()[1].tolist(), random.getstate()  # noqa: NPY002

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numba says which threading layers it passes over
        run(Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=2))  # loads what it needs
        threads, before = numba.get_num_threads(), states()
    builders = {"rude": Rude, "ekf": NamedEstimator("ekf")}
    results = run(Experiment(make_problem(), builders, runs=5))
    assert results.get("rude").ok.all()
    assert numba.get_num_threads() == threads
    assert states() == before
    alone = run(Experiment(make_problem(), {"ekf": builders["ekf"]}, runs=5), timing=False)
    assert alone.get("ekf").mean.tobytes() == results.get("ekf").mean.tobytes()


def test_blas_has_one_thread_meanwhile():
    def counts():
        pools = threadpoolctl.ThreadpoolController().lib_controllers
        return [pool.get_num_threads() for pool in pools if pool.user_api == "blas"]

    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        assert set(counts()) == {2}
        with undisturbed(make_problem()):
            assert set(counts()) == {1}
        assert set(counts()) == {2}


@pytest.mark.filterwarnings("ignore::UserWarning")  # numba says which threading layers it passes over
def test_threads_of_blas_change_no_bit():
    """240 beams: Haswell kernels solve systems of a hundred rows otherwise on two threads than on one."""
    space = position_space(heading=0.0)
    sensor = Rangefinder(ROOM, np.deg2rad(np.arange(0.0, 360.0, 1.5)), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(ROOM, space, [1.5, 2.5], [2.5, 3.5]))
    experiment = Experiment(problem, {"enkf": NamedEstimator("enkf")}, runs=4)
    found = []
    for threads in (1, 2):
        with threadpoolctl.threadpool_limits(threads, user_api="blas"):
            found.append(run(experiment, timing=False).get("enkf"))
    for array in ("mean", "covariance", "log_evidence"):
        assert getattr(found[0], array).tobytes() == getattr(found[1], array).tobytes()


def test_arrays_are_restored_where_a_view_was_closed_with_its_base():
    base = np.zeros((2, 2))
    prior = OwnPrior()
    prior.corner, prior.corners = base[0], [base]
    with undisturbed(replace(make_problem(), prior=prior)):
        assert not base.flags.writeable
        assert not prior.corner.flags.writeable
    assert base.flags.writeable
    assert prior.corner.flags.writeable
