"""BLAS held to one thread, and given back as it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from rangefix.filters import (
    ConstantVelocity,
    Gaussian,
    GaussianPrior,
    Mixture,
    Prior,
    Problem,
    Rangefinder,
    StateSpace,
    WithHeading,
    WithVelocity,
    build,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.filters.adaptive.prediction import predicted
from rangefix.maps import RectangularRoom
from rangefix.thread_pools import blas_on_one_thread, thread_pools

TWO = 2


def threads() -> set[int]:
    return {pool.get_num_threads() for pool in thread_pools() if pool.user_api == "blas"}


@pytest.fixture
def two() -> Iterator[None]:
    """BLAS on two threads, as a user may have it."""
    pools = [(pool, pool.get_num_threads()) for pool in thread_pools() if pool.user_api == "blas"]
    for pool, _ in pools:
        pool.set_num_threads(TWO)
    assert threads() == {TWO}
    yield
    for pool, before in pools:
        pool.set_num_threads(before)


@pytest.mark.usefixtures("two")
def test_held_within_each_other_and_given_back() -> None:
    """What somebody sets meanwhile does not last; after the outermost all is as before."""
    with blas_on_one_thread():
        assert threads() == {1}
        with blas_on_one_thread():
            for pool in thread_pools():
                pool.set_num_threads(TWO)
        assert threads() == {1}
    assert threads() == {TWO}


@pytest.mark.usefixtures("two")
def test_holders_that_overlap_give_back_what_was_there_before_the_first() -> None:
    """As in two threads: each of them alone would give back the one thread of the other."""
    with ExitStack() as first, ExitStack() as second:
        first.enter_context(blas_on_one_thread())
        second.enter_context(blas_on_one_thread())
        first.close()
        assert threads() == {1}
        second.close()
        assert threads() == {TWO}


@pytest.mark.usefixtures("two")
def test_the_adaptive_filter_holds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its threads beside those of BLAS took five to fifteen times as long on a busy machine."""
    seen: set[int] = set()

    def log_sum(*arguments: Any) -> Any:
        seen.update(threads())
        return kept(*arguments)

    kept = predicted.log_sum
    monkeypatch.setattr(predicted, "log_sum", log_sum)
    room, space = RectangularRoom(4.0, 6.0), velocity_space(0.4)
    start = GaussianPrior([1.5, 2.5], np.diag([0.3, 0.3]) ** 2, position_space(0.4), room)
    prior = WithVelocity(start, space, [0.2, 0.2], [0.2, 0.3])
    sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.2), space)
    problem = Problem(space, ConstantVelocity(space, 0.8, 0.02), sensor, prior)
    adaptive, rngs = build("adaptive-point-mass", problem, accuracy=0.3), [np.random.default_rng(0)]
    belief = adaptive.init(prior, rngs)
    reading = sensor.sample(prior.mean, np.random.default_rng(1))[None]
    belief = adaptive.update(belief, reading, rngs)
    adaptive.update(adaptive.predict(belief, np.zeros(0), rngs), reading, rngs)
    assert seen == {1}
    assert threads() == {TWO}


def priors(space: StateSpace) -> list[Prior]:
    """Priors whose moments are sums over many places, cut off at walls and wrapped, and a mixture of them."""
    room, mean, spread = RectangularRoom(4.0, 6.0), np.array([1.0, 3.0, 0.3]), np.diag([0.3, 0.2, 1.5])
    first = GaussianPrior(mean, spread, space, room)
    place = GaussianPrior(mean[:2], spread[:2, :2], position_space(0.0), room)
    second = WithHeading(place, space, mean=0.3, std=1.2)
    return [first, second, Mixture([first, second], (0.3, 0.7))]


@pytest.mark.usefixtures("two")
def test_priors_do_not_hang_on_the_threads_of_blas() -> None:
    """Else a study that Python runs had other last bits than by its command, which has one thread."""
    space = pose_space()
    with blas_on_one_thread():
        alone = [(prior.mean, prior.covariance) for prior in priors(space)]
    for prior, (mean, covariance) in zip(priors(space), alone, strict=True):
        assert np.array_equal(prior.mean, mean)
        assert np.array_equal(prior.covariance, covariance)
