"""Floor plans in GeoJSON and DXF: their lines and polygons, by shapely and ezdxf, as one floor plan."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...errors import one_line
from ...text_files import read_text
from ..base import MapError, check_point
from ..floor_plan import FloorPlan
from ..mesh_formats.read_mesh import UNITS, refuse_encoding
from .dxf_parts import CURVES, entity_kind, hidden_layers, layer_of, left_out, parts, stated_metres

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

VECTORS = (".geojson", ".dxf")
GEOJSON = ("FeatureCollection", "Feature", "GeometryCollection", "Polygon", "MultiPolygon", "LineString",
           "MultiLineString")  # fmt: skip
ONCE = (
    "width",
    "length",
    "outer",
    "holes",
    "walls",
    "type",
    "features",
    "geometry",
    "geometries",
    "coordinates",
)
BROKEN = (ValueError, TypeError, KeyError, AttributeError, IndexError, RecursionError)
STRETCHED = re.compile(r"\b(3857|900913|102100|102113|3785)$")  # names of Web Mercator
POINTS = ("Point", "MultiPoint")  # passed over
LARGEST, SMALLEST = 300.0, 1.0  # m of a plan; beyond them its unit is asked for
MOST_BYTES, MOST_CURVES = 1 << 27, 500_000
SAGITTA = 0.005  # m between a curve and the lines that stand for it
AREA = "the area that is taken of those they enclose"
NEAR = 1e-6  # m; ends as near as this are one


def is_geojson(content: Any) -> bool:
    """Whether the content of a JSON file is GeoJSON."""
    return isinstance(content, dict) and content.get("type") in GEOJSON


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A table of JSON in which no key that is read stands twice, of which Python would take the last.

    Raises:
        ValueError: If one does.
    """
    keys = [key for key, _ in pairs if key in ONCE]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise ValueError(f"{', '.join(twice)} stands twice")
    return dict(pairs)


def read_geojson(
    path: Path, content: Any = None, *, unit: str | None = None, reachable_from: ArrayLike | None = None
) -> FloorPlan:
    """The floor plan of a GeoJSON file.

    Polygons that one of them contains are what nobody stands in, in an outline; polygons side by side are
    rooms, with walls between. Lines are walls; without polygons they must enclose an area.

    Args:
        path: The file.
        content: What is in it, if it is read already.
        unit: Of its numbers; must be given where they could be degrees.
        reachable_from: A point of the area that is meant, m, where lines enclose several; the largest else.
            One that is not in the area that polygons make is refused.

    Raises:
        MapError: If it is none, its unit is open, or it makes no floor plan.
    """
    shapely = _library("shapely", path)
    if content is None:
        _check_bytes(path)
        try:
            content = json.loads(read_text(path), object_pairs_hook=once)
        except (ValueError, RecursionError) as error:
            raise MapError(f"{path}: not a GeoJSON file ({one_line(error)})") from None
    if not is_geojson(content):
        raise MapError(f"{path}: not a GeoJSON file: no type of {', '.join(GEOJSON)}")
    try:
        with np.errstate(invalid="ignore"):
            found = list(_geometries(content))
            points = sum(each.get("type") in POINTS for each in found)
            shapes = [shapely.geometry.shape(each) for each in found if each.get("type") not in POINTS]
            shapes = [shapely.force_2d(shape) for shape in shapes if not shape.is_empty]
    except (*BROKEN, shapely.errors.ShapelyError) as error:
        raise MapError(f"{path}: broken GeoJSON ({one_line(error)})") from None
    _refuse_web_mercator(content, path)
    box = _box(shapes, path)
    if unit is None and (np.abs(box) <= [180, 90, 180, 90]).all():
        raise MapError(
            f"{path}: its coordinates may be degrees, as GeoJSON has them, or metres: give unit = 'm' if "
            f"they are ({box[2] - box[0]:.4g} x {box[3] - box[1]:.4g} m), else project them to metres first"
        )
    told = (
        [f"{points} point{'s are' if points > 1 else ' is'} left out: walls are lines and polygons"]
        if points
        else []
    )
    return _plan_of(shapes, _metres(unit or "m", path), path, reachable_from, told)


def read_dxf(
    path: Path,
    *,
    unit: str | None = None,
    layers: Sequence[str] | None = None,
    reachable_from: ArrayLike | None = None,
) -> FloorPlan:
    """The floor plan of a DXF drawing: its lines, polylines, arcs, circles, ellipses and splines are walls.

    Args:
        path: The file.
        unit: Of its numbers; what its header says unless given, else metres if the size is one of a building.
        layers: Layers to read, in letters of any case; all unless given.
        reachable_from: A point of the area that is meant, m; the largest enclosed one unless given.

    Raises:
        MapError: If it is no drawing, its unit is open, a layer is not there, or its lines enclose no area.
    """
    ezdxf, shapely = _library("ezdxf", path), _library("shapely", path)
    _check_bytes(path)
    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)  # what it repairs it tells there
    try:
        drawing = ezdxf.readfile(path)
    except Exception as error:  # whatever a broken file makes of it
        raise MapError(f"{path}: not a DXF file that can be read ({one_line(error)})") from None
    stated = None if unit else stated_metres(drawing, path)
    scale = _metres(unit, path) if unit else stated or 1.0
    known = {layer.dxf.name for layer in drawing.layers} | set(map(layer_of, drawing.modelspace()))
    wanted = None if layers is None else {layer.casefold() for layer in layers}  # of any case, as in CAD
    lines, others, drawn = [], [], set()
    try:
        for number, (entity, layer) in enumerate(islice(parts(drawing.modelspace()), MOST_CURVES + 1)):
            if number == MOST_CURVES:
                raise MapError(f"{path}: more than {MOST_CURVES} entities; name the layers of its walls")
            known.add(layer)
            if wanted is not None and layer.casefold() not in wanted:
                continue
            if (kind := entity_kind(entity)) not in CURVES:
                others.append(kind)
            else:
                drawn.add(layer)
                curve = ezdxf.path.make_path(entity).flattening(SAGITTA / scale)
                corners = [(corner.x, corner.y) for corner in curve]
                lines += [shapely.LineString(corners)] if len(corners) > 1 else []
    except MapError:
        raise
    except RecursionError:
        raise MapError(f"{path}: a broken drawing (a block holds itself)") from None
    except (ValueError, TypeError, ezdxf.DXFError) as error:
        raise MapError(f"{path}: a broken drawing ({one_line(error)})") from None
    folded = {layer.casefold() for layer in known}
    if missing := sorted(layer for layer in set(layers or ()) if layer.casefold() not in folded):
        raise MapError(f"{path}: no layer {', '.join(missing)}; there are {', '.join(sorted(known))}")
    lines = [line for line in lines if line.length > 0]
    told = [*left_out(others), *([] if layers else hidden_layers(drawing, drawn))]
    if not lines and told:
        raise MapError(f"{path}: no walls in it: {told[0]}")
    box = _box(lines, path)
    size = (box[2:] - box[:2]) * scale
    if unit is None and stated is None and not SMALLEST <= size.max() <= LARGEST:
        sizes = [f"{' x '.join(f'{each * UNITS[name]:.4g}' for each in size)} m in {name}" for name in UNITS]
        raise MapError(f"{path}: give its unit: it would be {'; '.join(sizes)}")
    return _plan_of(lines, scale, path, reachable_from, told)


def _library(name: str, path: Path) -> Any:
    """A library that comes with the extra `maps`."""
    import importlib

    try:
        library = importlib.import_module(name)
        for part in {"ezdxf": ("path",), "shapely": ("geometry", "ops", "affinity")}[name]:
            importlib.import_module(f"{name}.{part}")
        return library
    except ModuleNotFoundError:
        raise MapError(f"{path}: reading it needs {name}: pip install 'rangefix[maps]'") from None


def _check_bytes(path: Path) -> None:
    """Refuse what is too large, or text that is not in UTF-8, before a library reads it."""
    if path.stat().st_size > MOST_BYTES:
        raise MapError(f"{path}: has more than {MOST_BYTES} bytes: too large for a floor plan")
    refuse_encoding(path)


def _refuse_web_mercator(content: dict[str, Any], path: Path) -> None:
    """Refuse coordinates whose metres are none on the ground: 1.6 to one in the middle of Europe."""
    crs = content.get("crs")
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = str(properties.get("name", "")) if isinstance(properties, dict) else ""
    if found := STRETCHED.search(name):
        raise MapError(
            f"{path}: its coordinates are Web Mercator ({found[1]}), whose metres are none "
            "on the ground: project them to metres first, such as UTM"
        )


def _metres(unit: str, path: Path) -> float:
    if unit not in UNITS:
        raise MapError(f"{path}: no unit {unit!r}; there are {', '.join(UNITS)}")
    return UNITS[unit]


def _geometries(content: dict[str, Any]) -> Iterable[dict[str, Any]]:
    """All geometries that are not collections."""
    kind = content.get("type")
    if kind == "FeatureCollection":
        for feature in content["features"]:
            yield from _geometries(feature)
    elif kind == "Feature":
        if content.get("geometry"):
            yield from _geometries(content["geometry"])
    elif kind == "GeometryCollection":
        for geometry in content["geometries"]:
            yield from _geometries(geometry)
    else:
        yield content


def _box(shapes: Sequence[BaseGeometry], path: Path) -> Any:
    """Lower and upper corner of all shapes, in the file's unit."""
    if not shapes:
        raise MapError(f"{path}: no lines and no polygons in it")
    corners = _library("shapely", path).get_coordinates(shapes)
    if not np.isfinite(corners).all():
        raise MapError(f"{path}: its coordinates are not all finite")
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)])


def _plan_of(
    shapes: Sequence[BaseGeometry],
    scale: float,
    path: Path,
    reachable_from: ArrayLike | None,
    remarks: Sequence[str] = (),
) -> FloorPlan:
    """One floor plan of lines and polygons, whose unit is so many metres; remarks are told with it."""
    shapely: Any = _library("shapely", path)
    if scale != 1.0:
        shapes = [shapely.affinity.scale(shape, scale, scale, origin=(0, 0)) for shape in shapes]
    parts = [part for shape in shapes for part in getattr(shape, "geoms", [shape])]
    polygons = [part for part in parts if part.geom_type == "Polygon"]
    lines = [part for part in parts if part.geom_type in ("LineString", "LinearRing")]
    if broken := next((each for each in polygons if not each.is_valid), None):
        raise MapError(f"{path}: a polygon crosses itself: {shapely.is_valid_reason(broken)}")
    if polygons:
        outline, walls, told = _of_polygons(polygons, shapely, path)
        _check_start(reachable_from, outline, shapely, path)
        walls, remarks = walls + lines, [*remarks, *told]
    else:
        outline, walls = _of_lines(lines, shapely, path, reachable_from)
    inner = shapely.unary_union(walls).intersection(outline) if walls else shapely.LineString()
    inner = inner.difference(outline.boundary.buffer(NEAR))
    segments = [
        (*one, *two)
        for line in getattr(inner, "geoms", [inner])
        if line.geom_type == "LineString"
        for one, two in zip(line.coords[:-1], line.coords[1:], strict=True)
        if np.hypot(two[0] - one[0], two[1] - one[1]) > 10 * NEAR
    ]
    try:
        return FloorPlan(
            _corners(outline.exterior, shapely),
            [_corners(ring, shapely) for ring in outline.interiors],
            segments,
            remarks=[*remarks, *_outside(lines, outline, shapely, "its polygons" if polygons else AREA)],
        )
    except MapError as error:
        raise MapError(f"{path}: {one_line(error)}") from None


def _outside(lines: list[Any], outline: Any, shapely: Any, area: str) -> list[str]:
    """How much of the lines is cut off, as it lies out of the outline, where no beam meets it."""
    whole = shapely.Polygon(outline.exterior).buffer(NEAR)
    shapely.prepare(whole)
    beyond = [line.difference(whole).length for line in lines if not whole.covers(line)]
    beyond = [length for length in beyond if length > 10 * NEAR]
    if not beyond:
        return []
    lie = "lie" if len(beyond) > 1 else "lies"
    told = f"{len(beyond)} of {len(lines)} lines {lie} outside {area}"
    return [f"{told}: {sum(beyond):.4g} m of walls are cut off"]


def _corners(ring: Any, shapely: Any) -> list[tuple[float, float]]:
    return [(x, y) for x, y in shapely.simplify(ring, NEAR).coords[:-1]]


def _of_polygons(polygons: list[Any], shapely: Any, path: Path) -> tuple[Any, list[Any], list[str]]:
    """Outline, inner walls and remarks: an outline with what nobody stands in, or rooms side by side."""
    largest = max(polygons, key=lambda polygon: shapely.Polygon(polygon.exterior).area)
    others = [polygon for polygon in polygons if not polygon.equals(largest)]  # one may be drawn twice
    within = shapely.unary_union(others).buffer(NEAR)
    open_holes = [hole for hole in map(shapely.Polygon, largest.interiors) if not within.contains(hole)]
    whole = shapely.unary_union([largest, *open_holes]).buffer(NEAR)  # rooms that fill a hole are rooms
    if all(whole.contains(other) for other in others):
        outline = largest.difference(shapely.unary_union(others))
        if outline.is_empty:
            raise MapError(
                f"{path}: the polygons within another fill it, and nobody stands in those: keep the rooms, "
                "or the outline with its pillars"
            )
        return _one_polygon(outline, path), [], []
    rooms, pillars = _rooms_and_pillars(polygons, shapely)
    free = shapely.unary_union(rooms).difference(shapely.unary_union(pillars))
    filled = len(largest.interiors) - len(open_holes)
    holes = f"{filled} hole{'s' * (filled > 1)} of a polygon {'are' if filled > 1 else 'is'} filled by others"
    told = [f"{holes}, which count as rooms: leave them out if nobody stands there"] if filled else []
    return _one_polygon(free, path), [room.boundary for room in rooms], told


def _rooms_and_pillars(polygons: list[Any], shapely: Any) -> tuple[list[Any], list[Any]]:
    """Polygons that no other contains, such as one that is drawn twice, and those that one does."""
    inner, outer = shapely.STRtree(shapely.buffer(polygons, NEAR)).query(polygons, predicate="within")
    pairs = set(zip(inner.tolist(), outer.tolist(), strict=True))
    within = {one for one, other in pairs if (other, one) not in pairs}
    rooms = [polygon for place, polygon in enumerate(polygons) if place not in within]
    return rooms, [polygons[place] for place in sorted(within)]


def _check_start(reachable_from: ArrayLike | None, outline: Any, shapely: Any, path: Path) -> None:
    """Refuse a point that is not in the one area that polygons make."""
    if reachable_from is None:
        return
    place = check_point(reachable_from, str(path))
    if not outline.covers(shapely.Point(place)):
        raise MapError(f"{path}: reachable_from {place.tolist()} is not in the area that its polygons make")


def _one_polygon(shape: Any, path: Path) -> Any:
    if shape.geom_type != "Polygon":
        count = len(getattr(shape, "geoms", []))
        raise MapError(f"{path}: its polygons make {count} areas that do not hang together; keep one of them")
    return shape


def _of_lines(
    lines: list[Any], shapely: Any, path: Path, reachable_from: ArrayLike | None
) -> tuple[Any, list[Any]]:
    """The area that lines enclose, the largest or the one about a point; and all lines, of it or not."""
    noded = shapely.unary_union(shapely.set_precision(shapely.MultiLineString(lines), NEAR))
    areas = list(shapely.ops.polygonize(noded))
    if not areas:
        box = np.array(noded.bounds)
        raise MapError(
            f"{path}: its {len(lines)} lines enclose no area ({box[2] - box[0]:.4g} x {box[3] - box[1]:.4g} m"
            "); draw the outline as lines that meet"
        )
    if reachable_from is not None:
        place = check_point(reachable_from, str(path))
        about = [area for area in areas if area.contains(shapely.Point(place))]
        if not about:
            raise MapError(f"{path}: reachable_from {place.tolist()} is in no area that its lines enclose")
        return about[0], [noded]
    return max(areas, key=_area), [noded]


_area: Callable[[Any], float] = lambda polygon: polygon.area  # noqa: E731
