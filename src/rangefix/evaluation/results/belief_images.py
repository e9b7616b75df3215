"""What the beliefs of one run look like, as saved: densities over the room and the heading."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import Array
from .files import ResultsError
from .npz import read_part
from .outcome import LARGEST

FILE = "pictures.npz"
NAMES = ("density", "extent", "headings", "heading_density")


@dataclass(frozen=True)
class Picture:
    """The belief of one estimator after the last measurement of run 0.

    Attributes:
        estimator: Its label.
        density: Over the room, (R, C), 1/m^2, x2 upwards along R.
        extent: Edges of its pixels, x1 left, x1 right, x2 lower, x2 upper, m.
        headings: Edges of the bins of an unknown heading, rad, (H + 1,); empty where it is known.
        heading_density: Over the heading, 1/rad, (H,).
    """

    estimator: str
    density: Array
    extent: Array
    headings: Array
    heading_density: Array


def load_pictures(folder: Path) -> tuple[Picture, ...]:
    """The pictures of a folder of results, in the study's order of estimators; none where none were saved."""
    path = folder / FILE
    if not path.exists():
        return ()
    arrays = read_part(path)
    try:
        pictures = tuple(
            Picture(str(arrays[f"{place}_estimator"]), *(arrays[f"{place}_{name}"] for name in NAMES))
            for place in range(sum(name.endswith("_estimator") for name in arrays))
        )
        sound = all(map(_is_sound, pictures))
    except (KeyError, TypeError):
        sound = False
    if not sound:
        raise ResultsError(f"{path} is damaged (no pictures of beliefs): delete it and run the study again")
    return pictures


def _is_sound(picture: Picture) -> bool:
    """Whether its arrays fit each other and are densities."""
    density, extent, edges, along = arrays = tuple(getattr(picture, name) for name in NAMES)
    if any(array.dtype != np.float64 or not (np.abs(array) <= LARGEST).all() for array in arrays):
        return False
    fit = density.ndim == 2 and extent.shape == (4,) and edges.ndim == along.ndim == 1
    fit = fit and density.size and len(edges) in (0, len(along) + 1)
    return bool(fit and (density >= 0).all() and (along >= 0).all())
