"""Floor plans in GeoJSON and DXF: lines, polygons and units as people draw them; one line for others."""

from __future__ import annotations

import json

import numpy as np
import pytest

from rangefix.maps import MapError, open_map
from rangefix.maps.describe import describe

from ..conftest import DATA

pytest.importorskip("shapely")
ezdxf = pytest.importorskip("ezdxf")
CASES = DATA.parent / "cases" / "maps"
ROUND = np.deg2rad([0.0, 90.0, 180.0, 270.0])
HALL = [[0, 0], [8, 0], [8, 5], [0, 5], [0, 0]]
PILLAR = [[4, 1], [5, 1], [5, 2], [4, 2], [4, 1]]
WALL = [[3, 0], [3, 4]]


def geojson(path, *shapes):
    features = [{"type": "Feature", "properties": {}, "geometry": shape} for shape in shapes]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def polygon(*rings):
    return {"type": "Polygon", "coordinates": rings}


def line(*points):
    return {"type": "LineString", "coordinates": points}


@pytest.mark.parametrize(
    "shapes",
    [
        [polygon(HALL, PILLAR), line(*WALL)],
        [polygon(PILLAR), polygon(HALL), {"type": "Point", "coordinates": [1, 1]}, line(*WALL)],
        [{"type": "GeometryCollection", "geometries": [line(*HALL), line(*WALL), line(*PILLAR)]}],
        [{"type": "MultiLineString", "coordinates": [HALL[:3], HALL[2:], PILLAR, WALL]}],
        [polygon([[0, 0, 1.5], *[[*corner, 1.5] for corner in HALL[1:]]], PILLAR), line(*WALL)],
    ],
)
@pytest.mark.parametrize("name", ["plan.geojson", "plan.json"])
def test_an_outline_a_pillar_and_a_wall(tmp_path, shapes, name):
    """As polygons, holes, lines or a mixture of them: the same plan."""
    plan = open_map(geojson(tmp_path / name, *shapes), unit="m")
    np.testing.assert_allclose(plan.ranges([4.5, 3.0, 0.0], ROUND), [2.0, 3.5, 1.0, 1.5])
    assert list(plan.is_free([[4.5, 1.5], [1.0, 1.0], [9.0, 1.0]])) == [False, True, False]


def test_what_is_left_out_of_a_plan_is_told(tmp_path):
    """Lines outside the polygons, by number and length, and points; nothing where all is within."""
    outside = line([7, 2], [9, 2]), line([0, 5.2], [8, 5.2]), {"type": "MultiPoint", "coordinates": [[1, 1]]}
    shapes = polygon(HALL, PILLAR), line(*WALL), line([0, 0], [8, 0]), line([4.2, 1.5], [4.8, 1.5])
    plan = open_map(geojson(tmp_path / "a.geojson", *shapes, *outside), unit="m")
    assert plan.remarks == (
        "1 point is left out: walls are lines and polygons",
        "2 of 5 lines lie outside its polygons: 9 m of walls are cut off",
    )
    clean = open_map(geojson(tmp_path / "b.geojson", *shapes), unit="m")
    assert clean.remarks == ()
    assert describe(plan).remarks == plan.remarks
    rooms = line(*HALL), line([20, 0], [22, 0], [22, 2], [20, 2], [20, 0])
    lines = open_map(geojson(tmp_path / "c.geojson", *rooms), unit="m")
    (told,) = lines.remarks
    assert (
        told
        == "1 of 2 lines lies outside the area that is taken of those they enclose: 8 m of walls are cut off"
    )


def test_geojson_with_a_mark_of_utf_8(tmp_path):
    path = geojson(tmp_path / "plan.geojson", polygon(HALL))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert open_map(path, unit="m").bounds[1].tolist() == [8, 5]


def test_rooms_side_by_side(tmp_path):
    """Make one plan, with a wall where they meet."""
    rooms = (
        polygon([[0, 0], [4, 0], [4, 5], [0, 5], [0, 0]]),
        polygon([[4, 0], [8, 0], [8, 5], [4, 5], [4, 0]]),
    )
    plan = open_map(geojson(tmp_path / "plan.geojson", *rooms), unit="m")
    np.testing.assert_allclose(plan.ranges([1.0, 1.0, 0.0], ROUND), [4.0, 3.0, 1.0, 1.0])
    assert plan.is_free([7.0, 1.0])


def test_a_pillar_in_one_of_several_rooms(tmp_path):
    """Nobody stands in it, as in one in a single room; it counted as a room, whose inside was free."""
    rooms = [polygon([[x, 0], [x + 4, 0], [x + 4, 5], [x, 5], [x, 0]]) for x in (0, 4)]
    pillar = polygon([[5, 1], [6, 1], [6, 2], [5, 2], [5, 1]])
    plan = open_map(geojson(tmp_path / "plan.geojson", *rooms, *2 * [rooms[0]], pillar), unit="m")
    assert list(plan.is_free([[5.5, 1.5], [4.5, 1.5], [1.0, 1.0]])) == [False, True, True]
    assert plan.free_moments(*plan.bounds)[0] == pytest.approx(39.0)
    np.testing.assert_allclose(plan.ranges([4.5, 1.5, 0.0], ROUND), [3.5, 0.5, 1.5, 0.5])


def test_rooms_that_fill_a_hole(tmp_path):
    """A corridor round rooms: they are rooms as any side by side are; they counted as a hole, unmentioned."""
    core = [[2, 1], [6, 1], [6, 4], [2, 4], [2, 1]]
    rooms = [polygon([[x, 1], [x + 2, 1], [x + 2, 4], [x, 4], [x, 1]]) for x in (2, 4)]
    for number, inner in enumerate(([polygon(core)], rooms)):
        plan = open_map(geojson(tmp_path / f"{number}.geojson", polygon(HALL, core), *inner), unit="m")
        assert plan.free_moments(*plan.bounds)[0] == pytest.approx(40.0)
        assert plan.remarks[0].startswith("1 hole of a polygon is filled by others, which count as rooms")
        assert list(plan.is_free([[3.0, 2.0], [5.0, 2.0], [1.0, 1.0]])) == [True, True, True]
        np.testing.assert_allclose(plan.ranges([3.0, 2.0, 0.0], ROUND), [2, 1 if number else 3, 1, 1])
        np.testing.assert_allclose(plan.ranges([1.0, 2.0, 0.0], ROUND), [3, 1, 2, 1])


def test_a_pillar_drawn_as_a_hole_with_something_in_it(tmp_path):
    shaft = (0.2 * np.array(PILLAR) + 0.8 * np.array([4.5, 1.5])).tolist()
    plan = open_map(geojson(tmp_path / "plan.geojson", polygon(HALL, PILLAR), polygon(shaft)), unit="m")
    assert plan.free_moments(*plan.bounds)[0] == pytest.approx(39.0)


def test_polygons_that_cover_one_another(tmp_path):
    """An outline that is drawn twice counts once; rooms that fill an outline leave nothing, which is told."""
    plan = open_map(geojson(tmp_path / "twice.geojson", *2 * [polygon(HALL)], polygon(PILLAR)), unit="m")
    assert list(plan.is_free([[4.5, 1.5], [1.0, 1.0]])) == [False, True]
    rooms = [polygon([[x, 0], [x + 4, 0], [x + 4, 5], [x, 5], [x, 0]]) for x in (0, 4)]
    with pytest.raises(MapError, match="the polygons within another fill it"):
        open_map(geojson(tmp_path / "filled.geojson", polygon(HALL), *rooms), unit="m")


def test_a_start_that_is_in_no_area_of_polygons(tmp_path):
    """It had no effect: the plan was opened as if it were not there."""
    path = geojson(tmp_path / "plan.geojson", polygon(HALL, PILLAR))
    assert open_map(path, unit="m", reachable_from=[1, 1]).bounds[1].tolist() == [8, 5]
    for place in ([9, 1], [4.5, 1.5]):
        with pytest.raises(MapError, match="is not in the area that its polygons make"):
            open_map(path, unit="m", reachable_from=place)


def test_a_start_that_is_no_point(tmp_path):
    """It was said to lie in no area, or in none that polygons make."""
    plan = geojson(tmp_path / "plan.geojson", polygon(HALL, PILLAR))
    drawing, space, path = dxf(tmp_path / "plan.dxf")
    space.add_lwpolyline(HALL, close=True)
    drawing.saveas(path)
    for file in (plan, path):
        for place in ([1.0, 1.0, 1.0], [float("nan"), 1.0]):
            with pytest.raises(MapError, match=r"plan\.\w+: reachable_from is a point \(x1, x2\)"):
                open_map(file, unit="m", reachable_from=place)


def test_degrees_are_not_guessed(tmp_path):
    """Within +-180 and +-90 the unit is asked for; beyond, numbers are metres."""
    path = geojson(tmp_path / "plan.geojson", polygon(HALL))
    with pytest.raises(MapError, match=r"may be degrees.*give unit = 'm' if they are \(8 x 5 m\)"):
        open_map(path)
    assert open_map(path, unit="foot").bounds[1][0] == pytest.approx(8 * 0.3048)
    far = [[x + 691_000, y + 5_400_000] for x, y in HALL]
    plan = open_map(geojson(tmp_path / "plan.geojson", polygon(far)))
    np.testing.assert_allclose(plan.ranges([691_002, 5_400_003, 0.0], ROUND), [2.0, 6.0, 3.0, 2.0])


def dxf(path, unit=0):
    drawing = ezdxf.new("R2010", units=unit)
    for name in ("WALLS", "DOORS"):
        drawing.layers.add(name)
    return drawing, drawing.modelspace(), path


def test_a_drawing(tmp_path):
    """Lines, polylines, circles and blocks are walls, in the unit of the header; layers may be chosen."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=4)
    space.add_lwpolyline([(0, 0), (8000, 0), (8000, 5000)], dxfattribs={"layer": "WALLS"})
    space.add_line((8000, 5000), (0, 5000), dxfattribs={"layer": "WALLS"})
    block = drawing.blocks.new("side")
    block.add_line((0, 0), (0, 5000), dxfattribs={"layer": "WALLS"})
    space.add_blockref("side", (0, 0), dxfattribs={"layer": "WALLS"})
    space.add_circle((6000, 2500), 500, dxfattribs={"layer": "WALLS"})
    space.add_line((3000, 0), (3000, 2600), dxfattribs={"layer": "DOORS"})
    space.add_text("office").set_placement((1000, 1000))
    drawing.saveas(path)
    plan = open_map(path)
    np.testing.assert_allclose(plan.ranges([2.0, 2.5, 0.0], ROUND), [2.5, 1.0, 2.5, 2.0])
    assert not plan.is_free([6.0, 2.5])
    plan = open_map(path, layers=["WALLS"])
    np.testing.assert_allclose(plan.ranges([2.0, 2.5, 0.0], ROUND), [2.5, 3.5, 2.5, 2.0], atol=0.006)
    with pytest.raises(MapError, match="no layer ROOF; there are 0, DOORS, Defpoints, WALLS"):
        open_map(path, layers=["ROOF"])


def test_walls_drawn_as_two_lines(tmp_path):
    """The room is taken, not the inside of its walls; the other room by a point in it."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=6)
    for low, high in (((-0.2, -0.2), (8.2, 5.2)), ((0, 0), (5, 5)), ((5.2, 0), (8, 5))):
        corners = [low, (high[0], low[1]), high, (low[0], high[1])]
        space.add_lwpolyline(corners, close=True)
    drawing.saveas(path)
    assert open_map(path).bounds[1].tolist() == [5, 5]
    assert open_map(path, reachable_from=(7.0, 1.0)).bounds[0].tolist() == [5.2, 0]
    with pytest.raises(MapError, match="is in no area"):
        open_map(path, reachable_from=(50.0, 1.0))


def test_a_drawing_without_a_unit(tmp_path):
    """Metres where that gives a building, asked for where it does not."""
    for scale, asked in ((1, False), (1000, True)):
        drawing, space, path = dxf(tmp_path / "plan.dxf")
        space.add_lwpolyline([(scale * x, scale * y) for x, y in HALL])
        drawing.saveas(path)
        if asked:
            with pytest.raises(MapError, match=r"give its unit: .* 8000 x 5000 m in m.* 8 x 5 m in mm"):
                open_map(path)
        plan = open_map(path, unit="mm") if asked else open_map(path)
        np.testing.assert_allclose(plan.bounds[1], [8, 5])


@pytest.mark.parametrize(
    ("number", "metres"), [(4, 0.001), (7, 1000.0), (10, 0.9144), (14, 0.1), (15, 10.0), (21, 0.3048006)]
)
def test_the_unit_of_the_header(tmp_path, number, metres):
    """Yards and decimetres are no metres; what is given comes before what the header states."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=number)
    space.add_lwpolyline(HALL)
    drawing.saveas(path)
    np.testing.assert_allclose(open_map(path).bounds[1], [8 * metres, 5 * metres], rtol=1e-6)
    np.testing.assert_allclose(open_map(path, unit="m").bounds[1], [8, 5])


def test_a_unit_that_is_not_read(tmp_path):
    """Light years are asked for, and not taken for metres."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=19)
    space.add_lwpolyline(HALL)
    drawing.saveas(path)
    with pytest.raises(MapError, match=r"plan.dxf: give its unit: .*\$INSUNITS 19"):
        open_map(path)
    np.testing.assert_allclose(open_map(path, unit="m").bounds[1], [8, 5])


def test_blocks_on_the_layer_of_their_reference(tmp_path):
    """What a block has on layer 0 is where the block is put, through blocks in blocks; other layers stay."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=6)
    inner = drawing.blocks.new("inner")
    inner.add_lwpolyline(HALL)
    inner.add_line(*WALL, dxfattribs={"layer": "DOORS"})
    drawing.blocks.new("outer").add_blockref("inner", (0, 0))
    space.add_blockref("outer", (0, 0), dxfattribs={"layer": "WALLS"})
    drawing.saveas(path)
    plan = open_map(path, layers=["WALLS"])
    assert (plan.bounds[1].tolist(), len(plan.walls)) == ([8, 5], 0)
    assert len(open_map(path).walls) == 1
    with pytest.raises(MapError, match="no lines"):
        open_map(path, layers=["0"])


def test_layers_that_stand_in_blocks_alone_or_in_other_letters(tmp_path):
    """A layer that only a block's lines name was said not to be there; CAD takes no note of capitals."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=6)
    space.add_lwpolyline(HALL, dxfattribs={"layer": "WALLS"})
    space.add_line((6, 0), (6, 3), dxfattribs={"layer": "Walls"})
    drawing.blocks.new("inner").add_line(*WALL, dxfattribs={"layer": "INNER"})
    space.add_blockref("inner", (0, 0), dxfattribs={"layer": "WALLS"})
    drawing.saveas(path)
    assert len(open_map(path, layers=["WALLS", "INNER"]).walls) == 2
    assert len(open_map(path, layers=["walls"]).walls) == 1
    with pytest.raises(MapError, match=r"no layer GATES; there are .*INNER, WALLS, Walls"):
        open_map(path, layers=["WALLS", "GATES"])


def test_dimensions_and_leaders_are_no_walls(tmp_path):
    """Their lines are not in the room; those of multilines are."""
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=6)
    space.add_lwpolyline(HALL)
    space.add_linear_dim(base=(0, 2.5), p1=(0, 0.5), p2=(8, 0.5)).render()
    space.add_leader([(2, 2), (4, 4), (5, 4)])
    drawing.saveas(path)
    plan = open_map(path)
    assert (plan.bounds[1].tolist(), len(plan.walls)) == ([8, 5], 0)
    space.add_mline([(3, 0), (3, 3)])
    drawing.saveas(path)
    assert len(open_map(path).walls) == 2


def test_what_may_be_walls_and_is_not_read_is_told(tmp_path):
    """Filled areas, faces and references to other files by number; texts are none; hidden layers by name."""
    drawing = ezdxf.new()
    drawing.header["$INSUNITS"] = 6
    drawing.layers.add("FURNITURE").freeze()
    drawing.layers.add("OFF").off()
    space = drawing.modelspace()
    space.add_text("hall")
    space.add_solid([(3, 2), (4, 2), (3, 3), (4, 3)])
    space.add_trace([(5, 2), (6, 2), (5, 3), (6, 3)])
    space.add_polyface().append_face([(3, 2, 0), (4, 2, 0), (4, 3, 0)])
    space.add_hatch().paths.add_polyline_path([(3, 2), (4, 2), (4, 3)])
    drawing.add_xref_def("walls.dwg", "WALLS")
    space.add_blockref("WALLS", (0, 0))
    drawing.saveas(tmp_path / "none.dxf")
    with pytest.raises(
        MapError, match=r"no walls in it: left out: filled area \(2\), hatch \(1\), mesh \(1\), ref"
    ):
        open_map(tmp_path / "none.dxf")
    space.add_lwpolyline(HALL)
    space.add_line((2, 1), (2, 2), dxfattribs={"layer": "FURNITURE"})
    drawing.saveas(tmp_path / "plan.dxf")
    plan = open_map(tmp_path / "plan.dxf")
    walls = "walls are lines, polylines, arcs, circles, ellipses and splines"
    assert plan.remarks == (
        f"left out: filled area (2), hatch (1), mesh (1), reference to another file (1); {walls}",
        "read though hidden in the drawing: FURNITURE; name the layers of its walls",
    )
    assert open_map(tmp_path / "plan.dxf", layers=["0"]).remarks == plan.remarks[:1]


def test_web_mercator_is_refused(tmp_path):
    """Its metres are none on the ground; other projections are taken, whatever they are called."""
    path = geojson(tmp_path / "plan.geojson", polygon([[x + 895000, y + 6900000] for x, y in HALL]))
    told = json.loads(path.read_text())
    for name, right in (("urn:ogc:def:crs:EPSG::3857", False), ("EPSG:900913", False), ("EPSG:25832", True)):
        path.write_text(json.dumps({**told, "crs": {"type": "name", "properties": {"name": name}}}))
        if right:
            assert open_map(path).bounds[1].tolist() == [895008, 6900005]
        else:
            with pytest.raises(MapError, match="Web Mercator"):
                open_map(path)


def test_a_block_that_holds_itself(tmp_path):
    drawing, space, path = dxf(tmp_path / "plan.dxf", unit=6)
    drawing.blocks.new("itself").add_blockref("itself", (1, 0))
    space.add_blockref("itself", (0, 0))
    drawing.saveas(path)
    with pytest.raises(MapError, match=r"plan.dxf: a broken drawing \(a block holds itself\)"):
        open_map(path)


BAD = {
    "empty.geojson": ('{"type": "FeatureCollection", "features": []}', "no lines and no polygons"),
    "other.geojson": ('{"kind": "plan"}', "not a GeoJSON file"),
    "broken.geojson": ('{"type": "Polygon"', "not a GeoJSON file"),
    "number.geojson": ('{"type": "Polygon", "coordinates": [[0, 1]]}', "broken GeoJSON"),
    "nan.geojson": ('{"type": "LineString", "coordinates": [[0, NaN], [1, 2]]}', "not all finite"),
    "crossed.geojson": (
        '{"type": "Polygon", "coordinates": [[[0,0],[1,1],[1,0],[0,1],[0,0]]]}',
        "crosses itself",
    ),
    "apart.geojson": (
        '{"type": "MultiPolygon", "coordinates": [[[[0,0],[1,0],[1,1],[0,0]]], [[[5,5],[6,5],[6,6],[5,5]]]]}',
        "2 areas that do not hang together",
    ),
    "open.geojson": ('{"type": "LineString", "coordinates": [[0, 0], [8, 0], [8, 5]]}', "enclose no area"),
    "deep.geojson": ('{"type": "Feature", "geometry": ' * 5000 + "{}" + "}" * 5000, "GeoJSON"),
    "curve.geojson": (
        '{"type": "GeometryCollection", "geometries": [{"type": "CircularString", "coordinates": [[0, 0]]}]}',
        "circularstring",
    ),
    "none.dxf": ("nothing", "not a DXF file"),
    "half.dxf": ("0\nSECTION\n2\nENTITIES\n0\nLINE\n8\nWALLS\n10\n0\n", "half.dxf: "),
    "plan.svg": ("<svg/>", "SVG is not read"),
    "plan.dwg": ("AC1027", "DWG is not read"),
    "map.pgm": ("P5", "give the .yaml"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_plan(tmp_path, name):
    """One line that names the file and says why."""
    content, words = BAD[name]
    path = tmp_path / name
    path.write_text(content)
    options = {} if path.suffix in (".svg", ".dwg", ".pgm") else {"unit": "m"}
    with pytest.raises(MapError, match=words) as refused:
        open_map(path, **options)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(path))


def test_a_bomb_of_blocks(tmp_path):
    """Blocks within blocks that would be a billion lines are refused."""
    drawing, space, path = dxf(tmp_path / "bomb.dxf")
    drawing.blocks.new("b0").add_line((0, 0), (1, 1))
    for level in range(1, 9):
        block = drawing.blocks.new(f"b{level}")
        for place in range(15):
            block.add_blockref(f"b{level - 1}", (place, 0))
    space.add_blockref("b8", (0, 0))
    drawing.saveas(path)
    from rangefix.maps.readers import vector_plans

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vector_plans, "MOST_CURVES", 500)
        with pytest.raises(MapError, match="more than 500 entities"):
            open_map(path)


def test_options_of_other_plans(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text('{"width": 4, "length": 6}')
    with pytest.raises(MapError, match=r"plan.json: unit has no effect on it"):
        open_map(path, unit="m")


@pytest.mark.parametrize("name", ["plan.geojson", "plan.json"])
def test_plans_made_by_hand(name):
    """The same plan of 8 x 5 m in two files."""
    if not (CASES / name).exists():
        pytest.skip(f"{CASES / name} is missing")
    plan = open_map(CASES / name, unit="m")
    np.testing.assert_allclose(plan.ranges([2.0, 3.0, 0.0], ROUND), [2, 6, 3, 2])


@pytest.mark.parametrize("kind", ["AEC_WALL", "ACAD_PROXY_ENTITY", "PLANESURFACE"])
@pytest.mark.parametrize("in_block", [False, True])
def test_objects_of_other_programs_are_told(tmp_path, kind, in_block):
    """Walls of AutoCAD Architecture ended in the library's words, and proxies were passed over in silence."""
    drawing = ezdxf.new("R2010")
    drawing.header["$INSUNITS"] = 6
    space = drawing.modelspace()
    space.add_lwpolyline([(0, 0), (4, 0), (4, 6), (0, 6)], close=True)
    holder = drawing.blocks.new("B") if in_block else space
    holder.add_line((1, 1), (2, 2))
    if in_block:
        space.add_blockref("B", (0, 0))
    drawing.saveas(tmp_path / "plan.dxf")
    text = (tmp_path / "plan.dxf").read_text()
    place = text.rindex("LINE\n", 0, text.index("AcDbLine\n"))
    (tmp_path / "plan.dxf").write_text(f"{text[:place]}{kind}\n{text[place + 5 :]}")
    plan = open_map(tmp_path / "plan.dxf")
    assert len(plan.segments) == 4
    what = "surface" if kind == "PLANESURFACE" else "object of another program, to be exploded there"
    assert plan.remarks[0].startswith(f"left out: {what} (1); walls are lines")
