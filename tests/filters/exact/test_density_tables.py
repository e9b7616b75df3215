"""Tables of log densities against the densities themselves."""

import numpy as np
import pytest

from rangefix.filters import Gaussian, Rangefinder, StudentT, position_space
from rangefix.filters.exact.density_tables import (
    CELL_ORIGIN,
    FINE_OCTAVES,
    Tables,
    at_offset,
    cell_ends,
    most_between,
    of_run,
)
from rangefix.filters.exact.filter import ExactPositionFilter
from rangefix.filters.models.beam_noise import BeamMixture, Quantised
from rangefix.filters.models.noise import RangeProportional

from ..families import draw
from .test_filter import ROOMS, pose

NEAR_NATS = 50.0  # below a density's peak, to which a table must be right
TOLERANCE_NATS = 1e-4  # four times what was measured, and what the filter states
NOISES = {
    "student": StudentT(scale=0.02, dof=3.0),
    "mixture": BeamMixture(hit=0.75, short=0.1, max=0.05, random=0.1, std=0.03, rate=1.0, max_range=10.0),
    "proportional": RangeProportional(a=0.01, b=0.01),
    "rounded": Quantised(Gaussian(0.03), 0.01),
}


def asked(tables: Tables, farthest: float) -> np.ndarray:
    """Ranges to compare at: everywhere that the filter asks, and more about the reading."""
    about = tables.centres[0] + np.linspace(-10, 10, 801) * tables.scales[0]
    ranges = np.concatenate([np.linspace(1e-6, farthest, 801), about])
    return np.sort(ranges[(ranges >= 1e-6) & (ranges <= farthest)])


@pytest.mark.parametrize("reading", [3.0, 0.04, 0.01, 9.9, np.inf])
@pytest.mark.parametrize("name", NOISES)
def test_tables_hold_the_densities(name, reading):
    """Right to 1e-4 nats where a density counts, also between a reading and range 0; bounds hold."""
    sensor = Rangefinder(ROOMS, [0.0], NOISES[name], position_space(0.0), max_range=10.0)
    problem = pose(ROOMS, [0.0], NOISES[name], max_range=10.0)
    estimator = ExactPositionFilter(problem)
    tables = of_run(estimator._tables.of(np.array([[[reading]]])), 0)
    ranges = asked(tables, estimator._tables.farthest)
    true = sensor.beam_log_density(np.array([reading]), ranges[:, None])[:, 0]
    mine = np.array(
        [at_offset(tables.cells, 0, (at - tables.centres[0]) / tables.scales[0]) for at in ranges]
    )
    peak = sensor.beam_log_density(np.array([reading]), tables.centres[:1])[0]
    near = true > max(peak, true.max()) - NEAR_NATS
    np.testing.assert_allclose(mine[near], true[near], rtol=0, atol=TOLERANCE_NATS)
    assert near.any() or reading > 9
    for low, high in np.random.default_rng(0).choice(ranges, (200, 2)):
        between = (ranges >= min(low, high)) & (ranges <= max(low, high))
        bound = most_between(tables, 0, min(low, high), max(low, high))
        assert bound >= mine[between].max() - TOLERANCE_NATS


def test_cells_are_found_by_their_ends():
    """A straight line in each cell comes out at its ends, fine and coarse, and beyond the last cell."""
    ends = cell_ends(8)
    assert ends[0] == 0
    assert (np.diff(ends) > 0).all()
    assert CELL_ORIGIN * (2.0**FINE_OCTAVES - 1) in ends
    cells = np.zeros((1, 2, len(ends) - 1, 4))
    cells[0, :, :, 0], cells[0, :, :, 1] = ends[:-1], np.diff(ends)
    for offset in [*ends[:-1], *(0.3 * ends[:-1] + 0.7 * ends[1:])]:
        assert at_offset(cells, 0, offset) == pytest.approx(offset, abs=1e-12)
        assert at_offset(cells, 0, -offset) == pytest.approx(offset, abs=1e-12)
    assert at_offset(cells, 0, 1e12) == pytest.approx(ends[-1])


def test_a_density_that_falls_as_a_power_far_from_its_reading():
    """A mixture that reads 2 cm: short readings make it fall as 1 / range over the whole room.

    Such parts were once integrated as one: the stated error was 1e-3.
    """
    drawn = draw("mixture", 378)
    estimator = ExactPositionFilter(drawn.problem)
    rngs = [np.random.default_rng(0)]
    belief = estimator.update(estimator.init(drawn.problem.prior, rngs), drawn.readings[:1], rngs)
    assert estimator.error(belief)[0] < 1.1e-4


def test_runs_and_readings_share_no_table() -> None:
    """Tables of a run are the same among others', and of several readings those of each by itself.

    Readings near together and far apart, beams that were not measured, and one that met nothing.
    """
    problem = pose(ROOMS, [0.0, 1.0, 2.0], NOISES["student"], max_range=10.0)
    estimator = ExactPositionFilter(problem)
    readings = np.array([[3.0, np.nan, 4.0], [0.02, 6.0, np.inf], [np.nan, np.nan, np.nan], [5.0, 0.5, 4.1]])
    together = estimator._tables.of(readings[:, None])
    assert together.counts.tolist() == [2, 3, 0, 3]
    for run, reading in enumerate(readings):
        alone, among = of_run(estimator._tables.of(reading[None, None]), 0), of_run(together, run)
        assert (alone.beams == among.beams).all()
        for which in range(len(alone.centres)):
            ranges = np.linspace(0.1, estimator._tables.farthest, 50)
            for each in (ranges - alone.centres[which]) / alone.scales[which]:
                assert at_offset(alone.cells, which, each) == at_offset(among.cells, which, each)
    layered = of_run(estimator._tables.of(readings[None]), 0)
    expected = np.linspace(0.1, estimator._tables.farthest, 50)
    for beam in range(3):
        logs = sum(
            np.array([at_offset(layered.cells, which, (at - layered.centres[which]) / layered.scales[which])
                      for at in expected])
            for which in np.flatnonzero(layered.beams == beam)
        )  # fmt: skip
        true = problem.sensor.beam_log_density(readings[:, None], expected[:, None])[..., beam].sum(axis=0)
        np.testing.assert_allclose(logs, true, rtol=0, atol=2 * TOLERANCE_NATS)
