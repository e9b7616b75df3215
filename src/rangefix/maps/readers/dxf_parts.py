"""What a DXF drawing is made of: its curves, also those in blocks, each with its layer, and its unit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Set
from pathlib import Path
from typing import Any

from ..base import MapError

CURVES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
OTHERS = {  # what may be walls, too, and is not read
    "INSERT": "reference to another file", "MPOLYGON": "hatch", "HATCH": "hatch", "SOLID": "filled area",
    "TRACE": "filled area", "3DFACE": "face in space", "MESH": "mesh", "REGION": "region", "BODY": "solid",
    "3DSOLID": "solid", "SURFACE": "surface", "PLANESURFACE": "surface", "EXTRUDEDSURFACE": "surface",
    "LOFTEDSURFACE": "surface", "REVOLVEDSURFACE": "surface", "SWEPTSURFACE": "surface",
    "ACAD_PROXY_ENTITY": "object of another program, to be exploded there",
}  # fmt: skip
FOREIGN = "ACAD_PROXY_ENTITY"  # what CAD makes of objects that it does not know, such as AEC_WALL
FREE_LAYER = "0"  # what is on it in a block is on the layer of the block's reference
UNITLESS = 0
METRES = {  # by the number that a header's $INSUNITS has
    1: 0.0254, 2: 0.3048, 3: 1609.344,  # inch, foot, mile
    4: 0.001, 5: 0.01, 6: 1.0, 7: 1000.0,  # mm, cm, m, km
    9: 2.54e-5, 10: 0.9144,  # mil, yard
    13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0,  # micrometre, dm, dam, hm
    21: 1200 / 3937, 22: 100 / 3937, 23: 3600 / 3937,  # foot, inch and yard of the US survey
}  # fmt: skip


def stated_metres(drawing: Any, path: Path) -> float | None:
    """How many metres the unit is that a drawing's header states; None where it states none.

    Raises:
        MapError: If it states one in which no building is drawn.
    """
    number = int(drawing.header.get("$INSUNITS", UNITLESS))
    if number == UNITLESS:
        return None
    if number not in METRES:
        raise MapError(f"{path}: give its unit: its header states one that is not read ($INSUNITS {number})")
    return METRES[number]


def parts(entities: Iterable[Any], layer: str = FREE_LAYER) -> Iterator[tuple[Any, str]]:
    """Entities with their layers, blocks and multilines taken apart; dimensions and leaders stay whole.

    Args:
        entities: Of the drawing, or of a block.
        layer: Where the block's reference is.
    """
    for entity in entities:
        own = layer_of(entity)
        own = layer if own == FREE_LAYER else own
        if entity.dxftype() == "INSERT" and _is_elsewhere(entity):
            yield entity, own
        elif entity.dxftype() == "INSERT" and entity.mcount > 1:
            yield from parts(entity.multi_insert(), own)
        elif entity.dxftype() == "INSERT":
            yield from parts(entity.virtual_entities(), own)
            kept = [each for each in entity.block() if entity_kind(each) == FOREIGN]  # which it passes over
            yield from ((each, layer_of(each)) for each in kept if not each.proxy_graphic)
        elif entity.dxftype() == "MLINE":
            yield from parts(entity.virtual_entities(), own)
        else:
            yield entity, own


def layer_of(entity: Any) -> str:
    """The layer of an entity; an object of another program, of which only the text is kept, has it there."""
    if _is_foreign(entity):
        return str(entity.graphic_properties().get("layer", FREE_LAYER))
    return str(entity.dxf.get("layer", FREE_LAYER))


def _is_foreign(entity: Any) -> bool:
    """Whether an entity is of a type that the library does not know."""
    return not entity.dxf.is_supported("layer")


def _is_elsewhere(reference: Any) -> bool:
    """Whether a reference is to another drawing, or to a block that is not there."""
    block = reference.block()
    return block is None or bool(block.block.is_xref)


def entity_kind(entity: Any) -> str:
    """The type of an entity; a polyline that is a net of faces is a mesh, and what is unknown foreign."""
    if _is_foreign(entity):
        return FOREIGN
    faces = entity.dxftype() == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh)
    return "MESH" if faces else str(entity.dxftype())


def left_out(kinds: Sequence[str]) -> list[str]:
    """What is told of entities that are not read and may be walls, by the types of all that are not read."""
    counts = Counter(OTHERS[kind] for kind in kinds if kind in OTHERS)
    if not counts:
        return []
    named = ", ".join(f"{name} ({count})" for name, count in sorted(counts.items()))
    return [f"left out: {named}; walls are lines, polylines, arcs, circles, ellipses and splines"]


def hidden_layers(drawing: Any, read: Set[str]) -> list[str]:
    """What is told of layers that were read and are not to be seen in the drawing."""
    hidden = {layer.dxf.name for layer in drawing.layers if layer.is_off() or layer.is_frozen()} & read
    if not hidden:
        return []
    return [f"read though hidden in the drawing: {', '.join(sorted(hidden))}; name the layers of its walls"]
