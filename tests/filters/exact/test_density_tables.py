"""Tables of log densities against the densities themselves."""

import numpy as np
import pytest

from rangefix.filters import Gaussian, Rangefinder, StudentT, position_space
from rangefix.filters.exact.density_tables import FINE_OCTAVES, Tables, at_offset, cell_ends, most_between
from rangefix.filters.exact.filter import ExactPositionFilter
from rangefix.filters.models.beam_noise import BeamMixture, Quantised
from rangefix.filters.models.noise import RangeProportional

from ..families import draw
from .test_filter import ROOMS, pose

FARTHEST_M = 12.0
NEAR_NATS = 50.0  # below a density's peak, to which a table must be right
TOLERANCE_NATS = 1e-4  # four times what was measured, and what the filter states
NOISES = {
    "student": StudentT(scale=0.02, dof=3.0),
    "mixture": BeamMixture(hit=0.75, short=0.1, max=0.05, random=0.1, std=0.03, rate=1.0, max_range=10.0),
    "proportional": RangeProportional(a=0.01, b=0.01),
    "rounded": Quantised(Gaussian(0.03), 0.01),
}


def asked(tables: Tables) -> np.ndarray:
    """Ranges to compare at: everywhere, and more about the reading."""
    about = tables.centres[0] + np.linspace(-10, 10, 801) * tables.scales[0]
    return np.sort(np.concatenate([np.linspace(1e-6, FARTHEST_M, 801), about[about > 1e-6]]))


@pytest.mark.parametrize("reading", [3.0, 0.04, 0.01, 9.9, np.inf])
@pytest.mark.parametrize("name", NOISES)
def test_tables_hold_the_densities(name, reading):
    """Right to 1e-4 nats where a density counts, also between a reading and range 0; bounds hold."""
    sensor = Rangefinder(ROOMS, [0.0], NOISES[name], position_space(0.0), max_range=10.0)
    problem = pose(ROOMS, [0.0], NOISES[name], max_range=10.0)
    tables = ExactPositionFilter(problem)._tables(np.array([[reading]]))
    ranges = asked(tables)
    true = sensor.beam_log_density(np.array([reading]), ranges[:, None])[:, 0]
    mine = np.array(
        [at_offset(tables.cells, 0, (at - tables.centres[0]) / tables.scales[0]) for at in ranges]
    )
    near = true > true.max() - NEAR_NATS
    np.testing.assert_allclose(mine[near], true[near], rtol=0, atol=TOLERANCE_NATS)
    for low, high in np.random.default_rng(0).choice(ranges, (200, 2)):
        between = (ranges >= min(low, high)) & (ranges <= max(low, high))
        bound = most_between(tables, 0, min(low, high), max(low, high))
        assert bound >= mine[between].max() - TOLERANCE_NATS


def test_cells_are_found_by_their_ends():
    """A straight line in each cell comes out at its ends, fine and coarse, and beyond the last cell."""
    ends = cell_ends(8)
    assert ends[0] == 0
    assert (np.diff(ends) > 0).all()
    assert 2.0**FINE_OCTAVES - 1 in ends
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
