"""What is saved for the map of a study: which beams return from the true position of the first run."""

from __future__ import annotations

import numpy as np

from rangefix.evaluation.results.map_snapshot import scene
from rangefix.filters import Gaussian, Rangefinder, Uniform, position_space
from rangefix.maps import RectangularRoom

DEG = np.deg2rad([0.0, 90.0, 180.0, 270.0, 60.0])


def test_beams_that_do_not_return_have_no_range() -> None:
    """From (1, 1) walls are 5, 3, 1 and 1 m ahead, right, behind and left of it, and sqrt(12) m at 60 deg.

    The map was drawn with beams to walls beyond the maximum range, in the blind sector and too slanted.
    """
    room, space = RectangularRoom(4.0, 6.0), position_space(0.0)
    prior = Uniform(room, space)

    def ranges(**limits: float) -> list[float]:
        sensor = Rangefinder(room, DEG, Gaussian(0.05), space, **limits)
        return np.round(scene(sensor, prior, [1.0, 1.0])["ranges"], 6).tolist()

    slanted = round(float(np.sqrt(12.0)), 6)
    assert ranges() == [5.0, 3.0, 1.0, 1.0, slanted]
    assert ranges(max_range=3.2) == [np.inf, 3.0, 1.0, 1.0, np.inf]
    assert ranges(blind_sector=float(np.deg2rad(120.0))) == [5.0, 3.0, np.inf, 1.0, slanted]
    assert ranges(max_incidence=float(np.deg2rad(20.0))) == [5.0, 3.0, 1.0, 1.0, np.inf]
