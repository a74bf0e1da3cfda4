"""Signs of the live page: a map's north and scale where nothing covers them, poles, streets, first
steps."""

from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from PIL import Image

from coview.live_signs import add_signs, find_free_spot, lay_picture
from placement_env.live.picture import keep_picture
from toolkit.plots.north_arrow import north
from toolkit.sites.files import load_site
from toolkit.sites.site import Mount, Site, Solid
from toolkit.viewing import scene


class Scene:
    """Scene that keeps what is added, by name."""

    def __init__(self) -> None:
        self.added: dict[str, SimpleNamespace] = {}

    def __getattr__(self, kind: str):
        def add(name: str, *values: object, **options: object) -> SimpleNamespace:
            values = values or tuple(options.values())
            self.added[name] = SimpleNamespace(kind=kind, values=values, **options)
            return self.added[name]

        return add


@pytest.fixture
def site() -> Site:
    return load_site("tjunction")


def test_poles_streets_north_and_scale_are_signs(site):
    drawn, poles = Scene(), site.mounts[:3]
    labels = add_signs(drawn, site, poles)
    assert sorted(labels) == sorted(pole.name for pole in poles)
    for pole in poles:
        top = pole.position + np.array([0.0, 0.0, pole.max_height])
        np.testing.assert_allclose(labels[pole.name].position, top)
    assert drawn.added["/signs/north/letter"].values == ("N",)
    assert drawn.added["/signs/scale/length"].values == ("20 m",)
    ends = drawn.added["/signs/scale"].values[0][0]
    assert np.linalg.norm(ends[1, :2] - ends[0, :2]) == pytest.approx(20.0)
    shaft = drawn.added["/signs/north"].values[0][0]
    np.testing.assert_allclose((shaft[1] - shaft[0])[:2] / 8.0, north(site), atol=1e-5)


def test_many_poles_have_no_names(site):
    many = [Mount(f"p{k}", np.array([0.1 * k, 0.0, 0.0])) for k in range(61)]
    assert len(add_signs(Scene(), site, many[:60])) == 60
    assert add_signs(Scene(), site, many) == {}


def test_signs_are_on_the_map_with_its_free_poles(site):
    drawn = Scene()
    add_signs(drawn, site, site.mounts[:3])
    assert "/site/poles in use" not in drawn.added
    fewer = Scene()
    add_signs(fewer, site, site.mounts[:1])
    counts = [len(made.added["/site/free poles"].values[0]) for made in (drawn, fewer)]
    assert counts[0] == 3 * counts[1] > 0


def test_on_bare_ground_north_is_in_the_far_corner_and_the_scale_in_the_near_one():
    site = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]))
    drawn = Scene()
    add_signs(drawn, site, ())
    shaft, *heads = drawn.added["/signs/north"].values[0]
    np.testing.assert_allclose(shaft, [[16.0, 10.0, 0.15], [16.0, 18.0, 0.15]], atol=1e-5)
    assert sorted(head[0][0] for head in heads) == pytest.approx([15.0, 17.0])
    assert [head[0][1] for head in heads] == pytest.approx([16.0, 16.0])
    letter = drawn.added["/signs/north/letter"]
    np.testing.assert_allclose(letter.position, [16.0, 19.5, 0.15])
    line, *ticks = drawn.added["/signs/scale"].values[0]
    np.testing.assert_allclose(line, [[-20.0, -19.0, 0.15], [-10.0, -19.0, 0.15]], atol=1e-5)
    for end, tick in zip(line, ticks, strict=True):
        np.testing.assert_allclose(tick[:, 0], [end[0]] * 2)
        np.testing.assert_allclose(tick[:, 1], [-19.8, -18.2], atol=1e-5)
    length = drawn.added["/signs/scale/length"]
    assert length.values == ("10 m",)
    np.testing.assert_allclose(length.position, line[1], atol=1e-5)
    assert (length.anchor, letter.anchor) == ("center-left", "center-center")
    assert letter.font_screen_scale > 1.0


def test_names_of_poles_and_streets_are_smaller_than_north():
    pole = Mount("p", np.array([0.0, 5.0, 0.0]))
    drawn = Scene()
    labels = add_signs(
        drawn, Site("s", np.array([-20.0, -10.0, 20.0, 10.0]), network=STREETS), [pole]
    )
    streets = [sign for node, sign in drawn.added.items() if node.startswith("/signs/streets/")]
    letter = drawn.added["/signs/north/letter"]
    for sign in (labels["p"], *streets):
        assert sign.font_screen_scale < 1.0 < letter.font_screen_scale
    assert labels["p"].anchor == "bottom-center"
    assert {sign.anchor for sign in streets} == {"center-center"}


def test_signs_are_where_no_solid_is(site):
    wall = Solid(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]), 0.0, 5.0)
    bare = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]), solids=(wall,))
    size = np.array([6.0, 6.0])
    spot = find_free_spot(bare, size, np.array([0.0, 0.0]))
    assert not shapely.box(*(spot - 3), *(spot + 3)).intersects(shapely.Polygon(wall.footprint))
    assert (np.abs(spot) <= 17.0).all()
    full = Site("s", np.array([-8.0, -8.0, 8.0, 8.0]), solids=(wall,))
    assert find_free_spot(full, size, np.array([5.0, 5.0])).tolist() == [5.0, 5.0]


def test_signs_are_not_hidden_behind_a_house_in_the_first_view():
    house = Solid(
        np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, -12.0], [-20.0, -12.0]]), 0.0, 20.0
    )
    site = Site("s", np.array([-30.0, -30.0, 30.0, 30.0]), solids=(house,))
    size = np.array([6.0, 2.0])
    spot = find_free_spot(site, size, np.array([0.0, -8.0]))
    eye, _ = scene.overview(tuple(site.area.tolist()))
    for corner in np.array([[-3.0, -1.0], [3.0, -1.0], [-3.0, 1.0], [3.0, 1.0]]):
        way = np.array(eye) - [*(spot + corner), 0.0]
        line = spot + corner + np.linspace(0, 20.0 / way[2], 200)[:, None] * way[:2]
        assert not shapely.Polygon(house.footprint).intersects(shapely.LineString(line))


def test_poles_have_a_mark_that_is_seen_from_above(site):
    added = Scene()
    add_signs(added, site, site.mounts[:2])
    marks = added.added["/signs/marks"].values[0].reshape(2, 4, 3)
    for pole, ends in zip(site.mounts, marks, strict=False):
        np.testing.assert_allclose(
            ends.mean(axis=0), pole.position + np.array([0.0, 0.0, pole.max_height]), atol=1e-5
        )
        assert np.ptp(ends, axis=0) == pytest.approx([1.0, 1.0, 0.0])
    many = [Mount(f"p{k}", np.array([0.1 * k, 0.0, 0.0])) for k in range(61)]
    add_signs(added, site, many)
    assert len(added.added["/signs/marks"].values[0]) == 2 * len(many)


STREETS = """<net>
<edge id="a" name="West Street"><lane id="a_0" shape="-200,0 -10,0" allow="passenger"/></edge>
<edge id="b" name="Edge Street"><lane id="b_0" shape="0,13 190,13" allow="passenger"/></edge>
<edge id="c" name="Far Street"><lane id="c_0" shape="30,-90 30,90" allow="passenger"/></edge>
</net>"""


def test_streets_and_lanes_up_to_the_signs_have_names_and_arrows():
    site = Site("s", np.array([-20.0, -10.0, 20.0, 10.0]), network=STREETS)
    drawn = Scene()
    add_signs(drawn, site, ())
    names = [sign for node, sign in drawn.added.items() if node.startswith("/signs/streets/")]
    assert {sign.values[0] for sign in names} == {"West Street", "Edge Street"}
    west = next(sign for sign in names if sign.values[0] == "West Street")
    np.testing.assert_allclose(west.position, [-17.0, 0.0, 0.15])
    arrows = drawn.added["/signs/lanes"].values[0].reshape(-1, 3, 2, 3)
    assert len(arrows) == 2
    for shaft, *heads in arrows:
        np.testing.assert_allclose(shaft[1] - shaft[0], [3.5, 0.0, 0.0], atol=1e-5)
        starts = np.array([head[0] for head in heads])
        np.testing.assert_allclose([head[1] for head in heads], [shaft[1], shaft[1]])
        np.testing.assert_allclose(starts[:, 0], shaft[1, 0] - 1.0, atol=1e-5)
        np.testing.assert_allclose(sorted(starts[:, 1] - shaft[1, 1]), [-0.5, 0.5], atol=1e-5)


def test_a_picture_lies_where_it_was_placed(tmp_path):
    site = load_site("tjunction")
    pixels = np.zeros((20, 40, 3), np.uint8)
    pixels[:10] = 255  # the northern half is white
    made = BytesIO()
    Image.fromarray(pixels).save(made, "PNG")
    picture = keep_picture("north.png", made.getvalue(), tmp_path, site.area)
    laid = replace(picture, x=3.0, y=4.0, scale=0.5, turn=np.pi / 2)
    drawn = Scene()
    lay_picture(drawn, site, laid, tmp_path)
    sign = drawn.added["/picture"]
    assert sign.values[1:] == (20.0, 10.0)
    assert sign.values[0][-1, :, :3].min() > 200  # viser's rows go north
    assert sign.values[0][0, :, :3].max() < 50
    assert (sign.values[0][..., 3] > 128).all()
    ground = float(site.ground(np.array([3.0, 4.0])))
    np.testing.assert_allclose(sign.position, (3.0, 4.0, ground), atol=0.1)
    assert sign.position[2] > ground
    assert sign.cast_shadow is False
    np.testing.assert_allclose(sign.wxyz, (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))


def test_a_sign_without_a_clear_place_is_among_trees_and_not_in_a_house():
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    house = Solid(10.0 * square - 10.0, 0.0, 5.0)  # over the near corner
    spots = [
        np.array([x, y]) for x in np.arange(-19.0, 20.0, 3.0) for y in np.arange(-19.0, 20.0, 3.0)
    ]
    trees = [Solid(0.5 * square + spot, 0.0, 1.0, "tree") for spot in spots]
    site = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]), solids=(house, *trees))
    spot = find_free_spot(site, np.array([6.0, 4.0]), site.area[:2])
    assert not shapely.box(*(spot - 2), *(spot + 2)).intersects(shapely.Polygon(house.footprint))


def test_signs_keep_clear_of_poles_and_their_names_where_they_can():
    pole = Mount("p", np.array([0.0, 0.0, 0.0]), 3.0, 8.0)
    site, size = (
        Site("s", np.array([-20.0, -20.0, 20.0, 20.0]), mounts=(pole,)),
        np.array([4.0, 4.0]),
    )
    foot, name = (find_free_spot(site, size, np.array(near)) for near in ([0.0, 0.0], [1.8, 9.2]))
    assert np.linalg.norm(foot) > 4.0
    beside = find_free_spot(site, size, site.area[:2], [shapely.box(-20.0, -20.0, -15.0, -15.0)])
    assert max(beside) > -13.0
    assert np.linalg.norm(name - [1.8, 9.2]) > 4.0  # its top, in the first view
    poles = [Mount(f"p{k}", np.array([3.0 * k - 30.0, -20.0, 0.0]), 3.0, 40.0) for k in range(20)]
    full = replace(site, mounts=tuple(poles))
    spot = find_free_spot(full, size, np.array([0.0, 18.0]))
    np.testing.assert_allclose(spot, [0.0, 18.0], atol=1.0)


def test_signs_are_within_the_area_and_fit_between_solids():
    bare, size = Site("s", np.array([-20.0, -20.0, 20.0, 20.0])), np.array([6.0, 2.0])
    assert find_free_spot(bare, size, bare.area[:2]).tolist() == [-17.0, -19.0]
    assert find_free_spot(bare, size, bare.area[2:]).tolist() == [17.0, 19.0]
    walls = [
        np.array([[x, -19.9], [x + 1, -19.9], [x + 1, 19.9], [x, 19.9]]) for x in (-14.0, -6.0)
    ]
    lane = replace(bare, solids=tuple(Solid(wall, 0.0, 0.1) for wall in walls))
    x, y = find_free_spot(lane, size, np.array([-9.5, 0.0]))
    assert -10.0 <= x <= -9.0  # in a gap of 7 m
    assert abs(y) < 1.0
