"""The map of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ....filters import RangeMap
from ....maps import open_map
from ....maps.readers import files_of
from .base import Misfit, Point, Positive, Section, Size, WithExtensions

CORNERS = "corners of the outline, for example [[0, 0], [4, 0], [4, 6]]"


class MapSection(Section):
    """A map, written down or in a file.

    Attributes:
        suffixes: Of the files that it reads, for a map of another package: by them `--map FILE`, and a `path`
            without a kind, find it.
    """

    suffixes: ClassVar[tuple[str, ...]] = ()

    def build(self, folder: Path) -> RangeMap:
        """The map; paths count from the folder."""
        built: RangeMap = open_map(self.model_dump(exclude_none=True), folder)
        return built

    def files(self, folder: Path) -> tuple[Path, ...]:
        """What `path` keys name, and what these files name: the image of a .yaml, the buffers of a .gltf."""
        return tuple(file for path in super().files(folder) for file in files_of(path, folder))


class RectangleMap(MapSection):
    """A rectangular room with its lower left corner at (0, 0)."""

    kind: Literal["rectangle"] = "rectangle"
    width_m: Size = Field(description="size along x1, for example width_m = 4.0")
    length_m: Size = Field(description="size along x2, for example length_m = 6.0")


class FloorPlanMap(MapSection):
    """An outline with holes and inner walls, here or in a file."""

    alternatives: ClassVar = (frozenset({"path", "outer_m", "holes_m", "walls_m"}),)
    kind: Literal["floor-plan"]
    path: str | None = Field(default=None, min_length=1, description="a .toml, .json, .geojson or .dxf file")
    unit: Literal["m", "cm", "mm", "inch", "foot"] | None = Field(
        default=None, description="of the numbers of GeoJSON and DXF"
    )
    layers: list[str] | None = Field(default=None, min_length=1, description="of a DXF; all unless given")
    reachable_from_m: Point | None = None
    outer_m: list[Point] | None = Field(default=None, min_length=3, description=CORNERS)
    holes_m: list[Annotated[list[Point], Field(min_length=3)]] | None = None
    walls_m: list[Annotated[list[float], Field(min_length=4, max_length=4)]] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> FloorPlanMap:
        if self.path is None and self.outer_m is None:
            raise Misfit("outer_m", f"is missing ({CORNERS}; or the path of a floor plan file)")
        own = ("unit", "layers", "reachable_from_m")
        if self.path is None and (useless := [key for key in own if getattr(self, key) is not None]):
            raise Misfit(useless[0], "has no effect on walls that are written here: it is for a file")
        if self.path is not None and (twice := self.model_fields_set & {"outer_m", "holes_m", "walls_m"}):
            raise Misfit(min(twice), "stands in the file that path names: leave one of them out")
        return self


class MeshMap(MapSection):
    """A triangle mesh, cut at the height of the rangefinder."""

    alternatives: ClassVar = (frozenset({"outline_m", "outline_path"}),)
    kind: Literal["mesh"]
    path: str = Field(
        min_length=1, description='a mesh file: run with --map FILE, or write path = "FILE" here'
    )
    sensor_height_m: float = 0.9
    reachable_from_m: Point | None = None
    resolution_m: Positive = 0.05
    floor_height_m: float | None = Field(default=None, description="z of the floor; found unless given")
    outline_m: list[Point] | None = Field(default=None, min_length=3, description=CORNERS)
    outline_path: str | None = Field(
        default=None, min_length=1, description="a map that is free where this is"
    )
    unit: Literal["m", "cm", "mm", "inch", "foot"] | None = Field(
        default=None, description="of the file's numbers; metres unless the file says otherwise"
    )
    up: Literal["x", "y", "z"] | None = Field(
        default=None, description="the file's axis that points up; y in glTF, what a .dae says, else z"
    )

    @model_validator(mode="after")
    def _one_outline(self) -> MeshMap:
        if self.outline_m is not None and self.outline_path is not None:
            raise Misfit("outline_m", "stands in the file that outline_path names: leave one of them out")
        return self


class OccupancyMapFile(MapSection):
    """A map that a robot has made, as ROS saves it: walls are cells of a grid."""

    kind: Literal["occupancy"]
    path: str = Field(min_length=1, description="the .yaml of map_server; --map FILE names another")
    unknown: Literal["excluded", "free", "wall"] = Field(
        default="excluded", description="what unknown cells are; excluded: nobody is there, and beams pass"
    )
    wall_lines: Literal["edges", "centre"] = Field(
        default="edges", description="where beams end: at cells' edges, or at centre lines of thick walls"
    )
    reachable_from_m: Point | None = None
    memory_gb: Positive = 2.0
    image_anywhere: bool = False


Ours = RectangleMap | FloorPlanMap | MeshMap | OccupancyMapFile
AnyMap = Annotated[Ours, WithExtensions(MapSection, Ours, "rangefix.maps")]
