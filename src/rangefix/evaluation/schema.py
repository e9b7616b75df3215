"""What may stand in a study file: lengths in metres (`_m`), angles in degrees (`_deg`)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ..filters import (
    Gaussian,
    Rangefinder,
    RangeMap,
    StateSpace,
    Uniform,
    position_space,
    sweep,
)
from ..filters.space import Array

Positive = Annotated[float, Field(gt=0)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]
LATTICE = 40  # steps along the shorter side of a box that looks for its place


class Section(BaseModel):
    """A part of a study; a key that it does not know is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class RectangleMap(Section):
    """A rectangular room with its lower left corner at (0, 0)."""

    kind: Literal["rectangle"] = "rectangle"
    width_m: Positive = Field(description="size along x1, for example width_m = 4.0")
    length_m: Positive = Field(description="size along x2, for example length_m = 6.0")

    def build(self, folder: Path) -> RangeMap:
        """The room."""
        from ..maps import RectangularRoom

        return RectangularRoom(width=self.width_m, length=self.length_m)


class FloorPlanMap(Section):
    """An outline with holes and inner walls."""

    kind: Literal["floor-plan"]
    outer_m: list[Point] = Field(
        min_length=3, description="corners of the outline, for example [[0, 0], [4, 0], [4, 6]]"
    )
    holes_m: list[Annotated[list[Point], Field(min_length=3)]] = []
    walls_m: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = []

    def build(self, folder: Path) -> RangeMap:
        """The floor plan."""
        from ..maps import FloorPlan

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
        from ..maps import MeshRoom

        return MeshRoom.load(
            folder / self.path,
            sensor_height=self.sensor_height_m,
            reachable_from=self.reachable_from_m,
            resolution=self.resolution_m,
        )


class SensorSection(Section):
    """A rangefinder: its beams, clockwise from straight ahead, and its noise."""

    bearings_deg: Annotated[list[float], Field(min_length=1)] | None = None
    resolution_deg: Positive | None = None
    blind_sector_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    std_m: Positive | Annotated[list[Positive], Field(min_length=1)] = Field(
        description="standard deviation of a reading, one or one per beam, for example std_m = 0.05"
    )

    @model_validator(mode="after")
    def _one_way(self) -> SensorSection:
        if (self.bearings_deg is None) == (self.resolution_deg is None):
            raise ValueError("give either bearings_deg, for example [326.3, 0.0, 33.7], or resolution_deg")
        if isinstance(self.std_m, list) and len(self.std_m) != len(self.bearings):
            raise ValueError(
                f"std_m has {len(self.std_m)} numbers for {len(self.bearings)} beams: give one for each"
            )
        return self

    @property
    def bearings(self) -> Array:
        """Bearings in rad, (B,)."""
        if self.resolution_deg is None:
            return np.asarray(np.deg2rad(self.bearings_deg or []))
        return sweep(np.deg2rad(self.resolution_deg), np.deg2rad(self.blind_sector_deg))

    def build(self, room: RangeMap, space: StateSpace) -> Rangefinder:
        """The rangefinder in a map."""
        return Rangefinder(
            room, self.bearings, Gaussian(self.std_m), space, np.deg2rad(self.blind_sector_deg)
        )


class StateSection(Section):
    """What is estimated: x1 and x2 under a known heading, clockwise from +x2."""

    heading_deg: float = 0.0

    def build(self) -> StateSpace:
        """The state space."""
        return position_space(heading=float(np.deg2rad(self.heading_deg)))


class PriorSection(Section):
    """Uniform over free space: of the whole map, of a box, or of a box of a size where most space is free."""

    kind: Literal["uniform"] = "uniform"
    lower_m: Point | None = None
    upper_m: Point | None = None
    size_m: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> PriorSection:
        if (self.lower_m is None) != (self.upper_m is None):
            raise ValueError("give both corners of the box, lower_m and upper_m, or neither")
        if self.size_m is not None and self.lower_m is not None:
            raise ValueError("give either the corners lower_m and upper_m, or size_m, not both")
        return self

    def build(self, room: RangeMap, space: StateSpace) -> Uniform:
        """The prior on a map."""
        if self.size_m is not None:
            return Uniform(room, space, *roomiest_box(room, np.array(self.size_m)))
        return Uniform(room, space, self.lower_m, self.upper_m)


class TruthSection(Section):
    """Where the object truly is: drawn from the prior for each run, or at one place."""

    draw: Literal["prior"] = Field(default="prior", alias="from")
    at_m: Point | None = None

    def start(self) -> Array | None:
        """The place, if there is one."""
        return None if self.at_m is None else np.array(self.at_m, dtype=float)


class EstimatorSection(Section):
    """An estimator by name, and its options with their units in the names."""

    name: str = Field(min_length=1, description='for example name = "point-mass"')
    label: str | None = Field(default=None, min_length=1)
    options: dict[str, Any] = {}

    @property
    def title(self) -> str:
        """The label, or the name."""
        return self.label or self.name

    def converted(self) -> dict[str, Any]:
        """Options as estimators take them: `cell_m` becomes cell, `width_deg` becomes width in rad."""
        return dict(_converted(name, value) for name, value in self.options.items())


def _converted(name: str, value: Any) -> tuple[str, Any]:
    if name.endswith("_m"):
        return name.removesuffix("_m"), value
    if name.endswith("_deg"):
        return name.removesuffix("_deg"), np.deg2rad(value).tolist()
    return name, value


def roomiest_box(room: RangeMap, size: Array) -> tuple[Array, Array]:
    """Lower and upper corner of the box of a size that holds the most free space; the first of equals."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
    size = np.minimum(size, upper - lower)
    step = float(size.min()) / LATTICE
    counts = np.maximum(1, np.floor((upper - lower) / step * (1 + 1e-9))).astype(int)
    axes = [low + step * (np.arange(count) + 0.5) for low, count in zip(lower, counts, strict=True)]
    free = room.is_free(np.stack(np.meshgrid(*axes, indexing="ij"), -1))
    sums = np.pad(free.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    wide, high = np.clip(np.round(size / step).astype(int), 1, counts)
    inside = sums[wide:, high:] - sums[:-wide, high:] - sums[wide:, :-high] + sums[:-wide, :-high]
    corner = lower + step * np.array(np.unravel_index(int(inside.argmax()), inside.shape))
    return corner, corner + size
