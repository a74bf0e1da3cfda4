"""Objects and signals of OpenDRIVE maps as solids and bays."""

import numpy as np
import pytest
import shapely

from toolkit.sites.opendrive.extract import roads_near
from toolkit.sites.opendrive.standing import Standing, standing_beside


@pytest.fixture
def found(street, tmp_path):
    def read(objects="", signals="") -> Standing:
        path = street(tmp_path, objects, signals)
        return standing_beside(roads_near(path, shapely.box(-40, -40, 40, 40), 0.0, 3.5))

    return read


def bounds(solid):
    return tuple(np.round([*solid.footprint.min(axis=0), *solid.footprint.max(axis=0), solid.base, solid.top], 3))


def test_a_box_is_turned_and_lifted(found):
    box = '<object type="building" s="60" t="20" zOffset="1.5" hdg="1.5707963" length="8" width="6" height="5"/>'
    ((solid,),) = found(box).groups
    assert solid.kind == "building"
    assert bounds(solid) == (7, 16, 13, 24, 1.5, 6.5)


def test_outlines_on_the_road_and_about_the_object(found):
    road = "".join(f'<cornerRoad s="{s}" t="{t}"/>' for s, t in ((10, 9), (20, 9), (20, 12)))
    local = "".join(f'<cornerLocal u="{u}" v="{v}"/>' for u, v in ((0, 0), (2, 0), (2, 1), (0, 1)))
    here = '<object type="{}" s="50" t="-10" hdg="{}" height="2"><{}</object>'
    corners = here.format("barrier", 0, f"outline>{road}</outline>")
    turned = here.format("building", np.pi / 2, f"outlines><outline>{local}</outline></outlines>")
    first, second = (group[0] for group in found(corners + turned).groups)
    assert (first.kind, bounds(first)) == ("wall", (-40, 9, -30, 12, 0, 2))
    assert bounds(second) == (-1, -10, 0, -8, 0, 2)


def test_trees_poles_and_what_repeats_them(found):
    repeat = '<repeat s="20" length="30" distance="10" tStart="8" tEnd="11"/>'
    made = found(f'<object type="tree" s="0" t="0" radius="1.5" height="6">{repeat}</object>')
    feet = [tuple(group[0].footprint.mean(axis=0).round(2)) for group in made.groups]
    assert feet == [(-30, 8), (-20, 9), (-10, 10), (0, 11)]
    assert [solid.kind for solid in made.groups[0]] == ["trunk", "tree", "tree", "tree"]
    assert made.groups[0][-1].top == 6.0
    lamp = found('<object type="streetLamp" s="50" t="7" radius="0.1"/>')
    assert (lamp.lamps, bounds(lamp.groups[0][0])[4:]) == ([(0.0, 7.0)], (0.0, 6.0))


def test_a_barrier_without_distance_runs_along_the_road(found):
    repeat = '<repeat s="10" length="16" distance="0" tStart="8" tEnd="8" heightStart="0.8" widthStart="0.4"/>'
    groups = found(f'<object type="barrier" s="0" t="0">{repeat}</object>').groups
    assert shapely.union_all([shapely.Polygon(g[0].footprint) for g in groups]).bounds == (-40, 7.8, -24, 8.2)
    assert {group[0].top for group in groups} == {0.8}


def test_bays_lie_along_their_longer_side(found):
    bay = '<object type="parkingSpace" s="50" t="-9" hdg="0.5" length="{}" width="{}"/>'
    made = found(bay.format(5, 2.5) + bay.format(2.5, 5))
    np.testing.assert_allclose(made.bays, [[0, -9, 0.5], [0, -9, 0.5 + np.pi / 2]])
    assert not made.groups


def test_what_is_flat_is_understood_and_what_is_unknown_is_counted(found):
    made = found(
        '<object type="crosswalk" s="5" t="0"/><object type="dragon" s="5" t="9"/><object type="dragon" s="6" t="9"/>'
        '<object type="-1" name="Speed_30" s="5" t="0"/>'
    )
    assert not made.groups
    assert made.understood == {"crosswalk": 1}
    assert made.unknown == {"dragon": 2, "-1 Speed_30": 1}


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
            "<repeat> makes 9000[01] objects: it must be 1 to 2000",
        ),
    ],
)
def test_damaged_objects(found, inside, message):
    with pytest.raises(ValueError, match=message):
        found(inside)
