"""The search of the adaptive filter: bounds of boxes against plain sums, and densities by few beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rangefix.filters import (
    BeamMixture,
    Gaussian,
    Noise,
    Rangefinder,
    StudentT,
    Uniform,
    pose_space,
)
from rangefix.filters.adaptive.range_bounds import penalties, shortfall_bounds
from rangefix.filters.adaptive.range_table import beam_order, build_table
from rangefix.filters.adaptive.target import Target
from rangefix.maps import FloorPlan

PLAN = FloorPlan(outer=[[0, 0], [6, 0], [6, 5], [0, 5]], walls=[[3, 0, 3, 2], [3, 3, 3, 5]])
BEARINGS = np.deg2rad(np.arange(0.0, 360.0, 24.0))


@pytest.mark.parametrize(
    ("noise", "max_range"),
    [
        (Gaussian(0.05), np.inf),
        (Gaussian(0.05), 3.0),
        (StudentT(0.05, 3.0), np.inf),
        (BeamMixture(0.97, 0.02, 0.005, 0.005, 0.05, 1.0, 8.0), np.inf),
    ],
)
def test_bounds_of_boxes_are_sums_of_the_least_each_beam_may_cost(noise: Noise, max_range: float) -> None:
    """Against numpy, box by box: noise of one peak, readings without a return, and noise of two peaks."""
    space, rng = pose_space(), np.random.default_rng(4)
    sensor = Rangefinder(PLAN, BEARINGS, noise, space, max_range=max_range)
    prior = Uniform(PLAN, space)
    table = build_table(sensor, prior, 200_000)
    for truth in prior.sample(6, rng):
        reading = sensor.sample(truth, rng)
        penalty, places = penalties(table, sensor, reading)
        order = beam_order(np.flatnonzero(~np.isnan(reading)))
        limits = table.limit(np.arange(1, len(order) + 1), 5.0)
        total = np.zeros((len(table.centres), len(table.headings)))
        possible = np.ones(total.shape, np.bool_)
        for limit, beam in zip(limits, order, strict=True):
            least, most = (
                np.minimum(bound[:, table.columns[:, beam]].astype(np.int64), penalty.shape[1] - 1)
                for bound in (table.low, table.high)
            )
            nearest = np.clip(places[beam], least, most)
            total += np.minimum.reduce([penalty[beam, place] for place in (nearest, least, most)])
            possible &= total <= limit
        expected = np.where(possible, total, np.inf).astype(np.float32)
        assert possible.any()
        assert not possible.all()
        assert np.array_equal(shortfall_bounds(table, sensor, reading, 5.0), expected)


def test_few_beams_say_what_all_say_with_the_others_unmeasured() -> None:
    """Every third of 15 beams, each with a noise of its own, one of them without a return."""
    space, rng = pose_space(), np.random.default_rng(4)
    noise = Gaussian(np.linspace(0.02, 0.3, len(BEARINGS)))
    sensor, prior = Rangefinder(PLAN, BEARINGS, noise, space, max_range=4.0), Uniform(PLAN, space)
    states = prior.sample(40, rng)
    reading = sensor.sample(states[0], rng)
    assert np.isinf(reading).any()
    target = Target(sensor, prior.log_density, reading[None])
    few = target.few(5)
    kept = np.linspace(0, len(BEARINGS) - 1, 5).round().astype(int)
    alone = np.full_like(reading, np.nan)
    alone[kept] = reading[kept]
    assert len(few.beams) == len(few.sensor.bearings) == 5
    others = replace(target, measurements=alone[None])
    assert few.log_density(states) == pytest.approx(others.log_density(states), rel=1e-12)
    assert few.perfect() == pytest.approx(others.perfect(), rel=1e-12)
    assert few.expected(states) == pytest.approx(others.expected(states)[:, kept], rel=1e-12)
