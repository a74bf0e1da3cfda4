import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from toolkit.geometry import pose
from toolkit.sites.furniture import post, rectangle
from toolkit.sites.opendrive.cubics import Cubics, read_cubics, read_number
from toolkit.sites.opendrive.ground_plane import find_plane
from toolkit.sites.opendrive.lane_surfaces import outline_lanes
from toolkit.sites.opendrive.map_file import read_opendrive
from toolkit.sites.opendrive.map_frame import move_shape_to_map, move_shape_to_site
from toolkit.sites.opendrive.map_projection import find_projection
from toolkit.sites.opendrive.map_roads import find_near_roads, read_road
from toolkit.sites.opendrive.road_objects import (
    RoadObjects,
    move_objects_to_site,
    read_road_objects,
    select_solids,
)

LANES = (
    '<lanes><laneOffset s="0" a="0.5"/><laneSection s="0"><left><lane id="2" '
    'type="sidewalk"><width sOffset="0" a="2"/></lane><lane id="1" type="driving"><width '
    'sOffset="0" a="3.5"/></lane></left><center><lane id="0" type="none"/></center><right><lane '
    'id="-1" type="driving"><width sOffset="0" a="3.5"/></lane><lane id="-2" type="parking">'
    '<width sOffset="0" a="2.5"/></lane><lane id="-3" type="sidewalk"><width sOffset="0" '
    'a="2"/></lane><lane id="-4" type="none"><width sOffset="0" '
    'a="0"/></lane></right></laneSection></lanes>'
)


def _street(folder, objects="", signals="", elevation="", lanes=LANES) -> Path:
    road = (
        '<road id="1" length="100" junction="-1"><planView><geometry s="0" x="-50" y="0" hdg="0" length="100"><line/>'
        f"</geometry></planView><elevationProfile>{elevation}</elevationProfile>{lanes}"
        f"<objects>{objects}</objects><signals>{signals}</signals></road>"
    )
    path = folder / "street.xodr"
    path.write_text(
        f'<OpenDRIVE xmlns="x"><header revMajor="1" revMinor="7"/>{road}</OpenDRIVE>',
        encoding="utf-8",
    )
    return path


@pytest.fixture
def street():
    return _street


def line_of(*shapes, x=10.0, y=5.0, heading=0.0, elevation=""):
    start, text = 0.0, ""
    for length, shape in shapes:
        text += (
            f'<geometry s="{start}" x="{x}" y="{y}" hdg="{heading}" '
            f'length="{length}">{shape}</geometry>'
        )
        start += length
    profile = f"<elevationProfile>{elevation}</elevationProfile>"
    return read_road(
        ElementTree.fromstring(f'<road id="7"><planView>{text}</planView>{profile}</road>')
    )


def test_lines_spirals_and_polynomials():
    line = line_of((20.0, "<line/>"), heading=np.pi / 2)
    np.testing.assert_allclose(
        line.at(np.array([0.0, 12.0])), [[10, 5, np.pi / 2], [10, 17, np.pi / 2]], atol=1e-12
    )
    np.testing.assert_allclose(
        line.step_aside(np.array([12.0]), np.array([3.0])), [[7, 17]], atol=1e-12
    )
    line = line_of((10.0, "<line/>"), (10.0, '<arc curvature="0.1"/>'))
    assert line.length == 20.0
    assert line.at(np.array([15.0]))[0, 2] == pytest.approx(0.5)
    line = line_of((20.0, '<spiral curvStart="0" curvEnd="0.05"/>'), x=0.0, y=0.0)
    end, rate = 20.0, 0.05 / 20.0
    ((x, y, heading),) = line.at(np.array([end]))
    assert heading == pytest.approx(rate * end**2 / 2)
    assert x == pytest.approx(end - rate**2 * end**5 / 40 + rate**4 * end**9 / 3456, abs=1e-3)
    assert y == pytest.approx(rate * end**3 / 6 - rate**3 * end**7 / 336, abs=1e-3)
    straight = '<paramPoly3 pRange="{}" aU="0" bU="{}" cU="0" dU="0" aV="0" bV="{}" cV="0" dV="0"/>'
    s = np.array([0.0, 5.0])
    for text in (straight.format("normalized", 6, 8), straight.format("arcLength", 0.6, 0.8)):
        np.testing.assert_allclose(
            line_of((10.0, text), x=0.0, y=0.0).at(s)[:, :2], [[0, 0], [3, 4]]
        )
    line = line_of(
        (50.0, "<line/>"),
        elevation='<elevation s="30" a="4" b="0.02"/><elevation s="0" a="1" b="0.1" c="0.001"/>',
    )
    np.testing.assert_allclose(line.elevation.at(np.array([0.0, 10, 40])), [1, 2.1, 4.2])
    np.testing.assert_allclose(line.elevation.slope(np.array([10.0, 40])), [0.12, 0.02])
    assert (Cubics(np.zeros(0), np.zeros((0, 4))).at(np.arange(3.0)) == 0).all()
    assert not len(read_cubics([]).starts)


def along(function, end):
    """Length of the curve (x, function(x)) to x = end, summed up finely."""
    x = np.linspace(0.0, end, 100_001)
    return np.hypot(np.diff(x), np.diff(function(x))).sum()


@pytest.mark.parametrize(("c", "d"), [(0.01, 0.0), (0.5, 0.0), (-0.02, 4e-4)])
def test_cubics_are_measured_along_the_curve(c, d):
    """ASAM OpenDRIVE 1.8, 9.6: s and length run along the reference line, u does not."""
    line = line_of((50.0, f'<poly3 a="0" b="0" c="{c}" d="{d}"/>'), x=0.0, y=0.0)
    for s in (0.0, 7.5, 25.0, 50.0):
        ((x, y, heading),) = line.at(np.array([s]))
        assert along(lambda u: c * u**2 + d * u**3, x) == pytest.approx(s, abs=0.01)
        assert y == pytest.approx(c * x**2 + d * x**3, abs=1e-9)
        assert np.tan(heading) == pytest.approx(2 * c * x + 3 * d * x**2)
    length = along(lambda u: c * u**2 + d * u**3, 20.0)
    normal = (
        '<paramPoly3 pRange="normalized" aU="0" bU="20" cU="0" dU="0" aV="0" bV="0" '
        f'cV="{400 * c}" dV="{8000 * d}"/>'
    )
    same = line_of((length, normal), x=0.0, y=0.0)
    np.testing.assert_allclose(
        same.at(np.array([7.5, length])), line.at(np.array([7.5, length])), atol=0.01
    )


@pytest.mark.parametrize("curvature", [0.1, -0.1, 1e-12])
def test_arc_lies_on_its_circle(curvature):
    line = line_of((15.0, f'<arc curvature="{curvature}"/>'), x=0.0, y=0.0)
    s = np.array([0.0, 5.0, 15.0])
    turn = curvature * s
    exact = [np.sin(turn) / curvature, (1 - np.cos(turn)) / curvature, turn]
    np.testing.assert_allclose(
        line.at(s), np.transpose(exact), atol=1e-3 if curvature == 1e-12 else 1e-9
    )


@pytest.mark.parametrize("text", ["nan", "inf", "1e9", "-1e300", "far", ""])
def test_what_is_no_number(text):
    with pytest.raises(
        ValueError, match=r"<a> needs a finite number as s, got .*: export it again"
    ) as raised:
        read_number(ElementTree.fromstring(f'<a s="{text}"/>'), "s")
    assert "\n" not in str(raised.value)
    assert read_number(ElementTree.fromstring("<a/>"), "s", 2.5) == 2.5


def test_damaged_geometry_and_what_would_stop_traffic():
    with pytest.raises(ValueError, match="road '7' has no <geometry>"):
        line_of()
    with pytest.raises(ValueError, match="holds <loop>, not one of line, arc"):
        line_of((5.0, "<loop/>"))
    with pytest.raises(ValueError, match="length of 0 to 100000 m, got -3"):
        line_of((-3.0, "<line/>"))
    there = RoadObjects(
        groups=[
            [post(0.0, 9.0, 3.0)],
            [post(0.0, 0.0, 3.0), post(0.0, 8.0, 3.0)],
            [post(90.0, 0.0, 3.0)],
            [],
        ]
    )
    there.unknown.update({"dragon": 2, "elf": 1})
    kept, notes = select_solids(
        there, WINDOW, [rectangle(-40.0, -4.0, 40.0, 4.0)], shapely.Polygon()
    )
    assert kept == there.groups[0]
    assert notes == [
        "1 objects or signals stand on the carriageway and were left out",
        "objects of types that are not known were left out: 2 'dragon', 1 'elf'",
    ]
    assert select_solids(
        RoadObjects(), WINDOW, [rectangle(-40.0, -4.0, 40.0, 4.0)], shapely.Polygon()
    ) == ([], [])


WINDOW = shapely.box(-40, -40, 40, 40)


def near(path, window, level, storey):
    return find_near_roads(read_opendrive(path, (0.0, 0.0)), window, level, storey)[0]


def test_lanes_lie_side_by_side_in_windows(street, tmp_path):
    (road,) = near(street(tmp_path), WINDOW, 0.0, 3.5)
    found = [(lane.kind, lane.outline.bounds, lane.width) for lane in outline_lanes(road)]
    assert found == [
        *(("driving", (-50, 0.5, 50, 4.0), 3.5), ("sidewalk", (-50, 4.0, 50, 6.0), 2.0)),
        *(("driving", (-50, -3.0, 50, 0.5), 3.5), ("parking", (-50, -5.5, 50, -3.0), 2.5)),
        ("sidewalk", (-50, -7.5, 50, -5.5), 2.0),
    ]
    np.testing.assert_allclose(
        list(outline_lanes(road))[3].middle[[0, -1]], [[-50, -4.25], [50, -4.25]]
    )
    high = street(tmp_path, elevation='<elevation s="0" a="6"/>')
    assert near(high, WINDOW, 0.0, 3.5) == []
    assert len(near(high, WINDOW, 4.0, 3.5)) == 1
    assert near(high, shapely.box(500, 500, 510, 510), 6.0, 3.5) == []
    path = street(
        tmp_path, elevation='<elevation s="0" a="0" b="-0.04"/><elevation s="95" a="-3.8" b="0.3"/>'
    )
    there = near(path, WINDOW, 0.0, 5.0)
    assert find_plane(there, WINDOW, np.eye(4))[2] == pytest.approx(0.04)
    assert find_plane(there, WINDOW.buffer(20.0), np.eye(4))[2] == pytest.approx(0.3)
    path = street(tmp_path, lanes='<lanes><laneSection s="zero"/></lanes>')
    with pytest.raises(ValueError, match="<laneSection> needs a finite number as s, got 'zero'"):
        list(outline_lanes(near(path, WINDOW, 0.0, 3.5)[0]))
    path = street(tmp_path, elevation='<elevation s="0" a="up"/>')
    with pytest.raises(ValueError, match="<elevation> needs a finite number as a, got 'up'"):
        near(path, WINDOW, 0.0, 3.5)


def test_frames_are_inverse_and_things_move_to_the_site():
    spot = shapely.Point(3.0, 4.0)
    there = pose(10.0, -20.0, 5.0, yaw=np.pi / 2)
    assert move_shape_to_map(spot, there).equals_exact(shapely.Point(6.0, -17.0), 1e-9)
    assert move_shape_to_site(move_shape_to_map(spot, there), there).equals_exact(spot, 1e-9)
    standing = RoadObjects(
        groups=[[post(12.0, 5.0, 3.0)]], bays=[(12.0, 5.0, 1.0)], lamps=[(10.0, 6.0)]
    )
    moved = move_objects_to_site(standing, pose(10.0, 5.0, yaw=np.pi / 2))
    np.testing.assert_allclose(moved.groups[0][0].footprint.mean(axis=0), [0, -2], atol=1e-3)
    np.testing.assert_allclose(moved.bays, [[0, -2, 1.0 - np.pi / 2]], atol=1e-9)
    np.testing.assert_allclose(moved.lamps, [[1, 0]], atol=1e-9)


def test_the_plane_of_the_roads_in_the_frame_of_the_site(street, tmp_path):
    there = near(street(tmp_path, elevation='<elevation s="0" a="3" b="-0.04"/>'), WINDOW, 0.0, 5.0)
    along, off, _ = find_plane(there, WINDOW, pose(5.0, 2.0, 1.0))
    assert along == pytest.approx((-0.04, 0.0))  # one road says nothing of the slope across it
    assert off == pytest.approx(0.0, abs=1e-9)
    turned, *_ = find_plane(there, WINDOW, pose(yaw=np.pi / 2))
    assert turned == pytest.approx((0.0, 0.04))
    bent = street(
        tmp_path, elevation='<elevation s="0" a="3" b="-0.04"/><elevation s="50" a="1" b="0.0"/>'
    )
    slope, off, _ = find_plane(near(bent, WINDOW, 0.0, 5.0), WINDOW, np.eye(4))
    assert -0.04 < slope[0] < 0.0
    assert 0.05 < off < 1.0
    assert find_plane([], WINDOW, np.eye(4)) == ((0.0, 0.0), 0.0, 0.0)


def test_place_and_projection(street, tmp_path):
    path = street(tmp_path)
    assert find_projection(read_opendrive(path, (0.0, 0.0)), path.name) is None
    with pytest.raises(ValueError, match="centre 900 0 lies outside the map"):
        read_opendrive(path, (900.0, 0.0))
    text = path.read_text()
    for named, found in (("+proj=utm +zone=32", True), ("EPSG:25832", True), ("+lat_0=4", False)):
        path.write_text(
            text.replace('revMinor="7"/>', f"><geoReference>{named}</geoReference></header>")
        )
        root = read_opendrive(path, (0.0, 0.0))
        if found:
            assert find_projection(root, path.name) == named
        else:
            with pytest.warns(
                UserWarning,
                match=r"street\.xodr: its geoReference names no projection \('\+lat_0=4'\)",
            ):
                assert find_projection(root, path.name) is None
    path.write_text('<?xml version="1.0" encoding="klingon"?><OpenDRIVE/>')
    with pytest.raises(ValueError, match="damaged one"):
        read_opendrive(path, (0.0, 0.0))


@pytest.fixture
def found(street, tmp_path):
    def read(objects="", signals="") -> RoadObjects:
        path = street(tmp_path, objects, signals)
        return read_road_objects(near(path, shapely.box(-40, -40, 40, 40), 0.0, 3.5))

    return read


def bounds(solid):
    return tuple(
        np.round(
            [*solid.footprint.min(axis=0), *solid.footprint.max(axis=0), solid.base, solid.top], 3
        )
    )


def test_boxes_barriers_and_bays_are_turned_and_run_along_the_road(found):
    box = (
        '<object type="building" s="60" t="20" zOffset="1.5" hdg="1.5707963" length="8" '
        'width="6" height="5"/>'
    )
    ((solid,),) = found(box).groups
    assert solid.kind == "building"
    assert bounds(solid) == (7, 16, 13, 24, 1.5, 6.5)
    repeat = (
        '<repeat s="10" length="16" distance="0" tStart="8" tEnd="8" heightStart="0.8" '
        'widthStart="0.4"/>'
    )
    groups = found(f'<object type="barrier" s="0" t="0">{repeat}</object>').groups
    assert shapely.union_all([shapely.Polygon(g[0].footprint) for g in groups]).bounds == (
        -40,
        7.8,
        -24,
        8.2,
    )
    assert {group[0].top for group in groups} == {0.8}
    bay = '<object type="parkingSpace" s="50" t="-9" hdg="0.5" length="{}" width="{}"/>'
    made = found(bay.format(5, 2.5) + bay.format(2.5, 5))
    np.testing.assert_allclose(made.bays, [[0, -9, 0.5], [0, -9, 0.5 + np.pi / 2]])
    assert not made.groups
    made = found(
        '<object type="crosswalk" s="5" t="0"/><object type="dragon" s="5" t="9"/><object '
        'type="dragon" s="6" t="9"/><object type="-1" name="Speed_30" s="5" t="0"/>'
    )
    assert not made.groups
    assert made.understood == {"crosswalk": 1}
    assert made.unknown == {"dragon": 2, "-1 Speed_30": 1}


def test_outlines_and_repeated_objects_stand_beside_the_road(found):
    road = "".join(f'<cornerRoad s="{s}" t="{t}"/>' for s, t in ((10, 9), (20, 9), (20, 12)))
    local = "".join(f'<cornerLocal u="{u}" v="{v}"/>' for u, v in ((0, 0), (2, 0), (2, 1), (0, 1)))
    here = '<object type="{}" s="50" t="-10" hdg="{}" height="2"><{}</object>'
    corners = here.format("barrier", 0, f"outline>{road}</outline>")
    turned = here.format("building", np.pi / 2, f"outlines><outline>{local}</outline></outlines>")
    first, second = (group[0] for group in found(corners + turned).groups)
    assert (first.kind, bounds(first)) == ("wall", (-40, 9, -30, 12, 0, 2))
    assert bounds(second) == (-1, -10, 0, -8, 0, 2)
    repeat = '<repeat s="20" length="30" distance="10" tStart="8" tEnd="11"/>'
    made = found(f'<object type="tree" s="0" t="0" radius="1.5" height="6">{repeat}</object>')
    feet = [tuple(group[0].footprint.mean(axis=0).round(2)) for group in made.groups]
    assert feet == [(-30, 8), (-20, 9), (-10, 10), (0, 11)]
    row = found(
        '<object type="pole" s="5" t="9"><repeat s="0" length="2.4" distance="0.8"/></object>'
    )
    assert len(row.groups) == 4  # though 2.4 / 0.8 is below 3 in float64
    assert [solid.kind for solid in made.groups[0]] == ["trunk", "tree", "tree", "tree"]
    assert made.groups[0][-1].top == 6.0
    lamp = found('<object type="streetLamp" s="50" t="7" radius="0.1"/>')
    assert (lamp.lamps, bounds(lamp.groups[0][0])[4:]) == ([(0.0, 7.0)], (0.0, 6.0))


@pytest.mark.parametrize(
    ("attributes", "depth", "levels"),
    [
        ('dynamic="no" zOffset="2.5" height="0.8" width="0.6"', 0.06, (2.5, 3.3)),
        ('dynamic="yes" zOffset="-0.7" height="1.16" width="0.6"', 0.3, (2.1, 3.26)),
        ('dynamic="no"', 0.06, (2.1, 2.7)),
    ],
)
def test_signals_face_those_they_are_for(found, attributes, depth, levels):
    ((post, plate),) = found(signals=f'<signal s="50" t="-6" orientation="+" {attributes}/>').groups
    assert (post.kind, plate.kind, post.base, post.top) == ("post", "sign", 0.0, levels[0])
    assert bounds(plate) == pytest.approx((-depth / 2, -6.3, depth / 2, -5.7, *levels))


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<object type="tree" s="5" t="nan"/>', "<object> needs a finite number as t, got 'nan'"),
        ('<object type="tree" t="5"/>', "<object> needs a finite number as s, got 'None'"),
        (
            '<object type="pole" s="5" t="9"><repeat s="0" length="90" distance="0.001"/></object>',
            "<repeat> needs both from 0 up and at most 2000 objects, but .* make 9000[01]",
        ),
    ],
)
def test_damaged_objects_are_left_out(found, inside, message):
    standing = found(f'<object type="tree" s="5" t="9"/>{inside}')
    assert len(standing.groups) == 1
    (reason,) = standing.damaged
    assert re.match(message, reason)
    _, notes = select_solids(
        standing, WINDOW, [rectangle(-40.0, -4.0, 40.0, 4.0)], shapely.Polygon()
    )
    assert re.match(f"1 damaged objects or signals were left out: {message}", notes[-1])


@pytest.mark.parametrize(
    "numbers",
    ['length="50" distance="-10"', 'length="-9" distance="0"', 'length="9" distance="1e-9"'],
)
def test_endless_repeats_are_left_out(found, numbers):
    standing = found(f'<object type="pole" s="5" t="9"><repeat s="0" {numbers}/></object>')
    assert not standing.groups
    assert "needs both from 0 up and at most 2000 objects" in standing.damaged[0]
