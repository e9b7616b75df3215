"""The map of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ....filters import RangeMap
from .base import Point, Positive, Section


class RectangleMap(Section):
    """A rectangular room with its lower left corner at (0, 0)."""

    kind: Literal["rectangle"] = "rectangle"
    width_m: Positive = Field(description="size along x1, for example width_m = 4.0")
    length_m: Positive = Field(description="size along x2, for example length_m = 6.0")

    def build(self, folder: Path) -> RangeMap:
        """The room."""
        from ....maps import RectangularRoom

        return RectangularRoom(width=self.width_m, length=self.length_m)


class FloorPlanMap(Section):
    """An outline with holes and inner walls."""

    kind: Literal["floor-plan"]
    outer_m: list[Point] = Field(
        min_length=3, description="corners of the outline, for example [[0, 0], [4, 0], [4, 6]]"
    )
    holes_m: list[Annotated[list[Point], Field(min_length=3)]] = Field(default_factory=list)
    walls_m: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = Field(default_factory=list)

    def build(self, folder: Path) -> RangeMap:
        """The floor plan."""
        from ....maps import FloorPlan

        holes = [np.array(hole) for hole in self.holes_m]
        return FloorPlan(np.array(self.outer_m), holes, np.array(self.walls_m).reshape(-1, 4))


class MeshMap(Section):
    """A triangle mesh, cut at the height of the rangefinder."""

    kind: Literal["mesh"]
    path: str = Field(
        min_length=1, description='a mesh file: run with --map FILE, or write path = "FILE" here'
    )
    sensor_height_m: float = 0.9
    reachable_from_m: Point | None = None
    resolution_m: Positive = 0.05

    def build(self, folder: Path) -> RangeMap:
        """The mesh; its path counts from the study's folder."""
        from ....maps import MeshRoom

        return MeshRoom.load(
            folder / self.path,
            sensor_height=self.sensor_height_m,
            reachable_from=self.reachable_from_m,
            resolution=self.resolution_m,
        )
