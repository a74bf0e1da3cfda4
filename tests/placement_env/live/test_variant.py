"""Variants and the yard they are made in: what a file may say of sensors and poles, and where one
may stand."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from placement_env.candidates.candidates import aim_sensor, pool
from placement_env.live.variant import (
    KERB_GAP_M,
    MAX_DRAWN_POLE_DISTANCE_M,
    MAX_NAME_LENGTH,
    MAX_TURN_RAD,
    MAX_VARIANT_SENSORS,
    SNAP_M,
    LiveSensor,
    Variant,
    Yard,
    check_keep_out,
    check_name,
    free_name,
    name_on_pole,
)
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import load_site
from toolkit.sites.site import Mount

SITE = load_site("tjunction")
STOCK = pool(SITE)
POLE = STOCK.mounts[3]
X, Y, FOOT = POLE.position.tolist()
SENSOR = LiveSensor("a", "depth-camera", POLE.name, X, Y, 5.0, -1.0, 0.3)
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))


@pytest.fixture(scope="module")
def yard():
    return Yard.from_stock(SITE, STOCK, SITE.sensors, ())


def hang(x=X, y=Y, height=5.0, heading=0.0, tilt=0.3, name="s", model=None):
    sensor = replace(STOCK.sensors[0], name=name)
    sensor = sensor if model is None else replace(sensor, model=model)
    return aim_sensor(sensor, np.array([x, y, FOOT + height]), heading, tilt)


def test_what_is_written_is_read_again():
    pole = Mount("own pole 1", np.array([1.0, 2.0, 0.5]), 2.5, 7.5, 3.0, 900.0, 2, "drawn")
    variant = Variant(
        (SENSOR, replace(SENSOR, name="b", locked=True, failed=True)), (pole,), (SQUARE,)
    )
    again = Variant.from_dict(variant.as_dict())
    assert again.sensors == variant.sensors
    assert again.keep_out == variant.keep_out
    assert again.as_dict() == variant.as_dict()
    bare = {"sensors": [], "poles": []}
    assert Variant.from_dict(bare) == Variant()
    for heading in (-MAX_TURN_RAD, MAX_TURN_RAD):
        row = {**vars(SENSOR), "heading": heading}
        assert Variant.from_dict({"sensors": [row], "poles": []}).sensors[0].heading == heading


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sensors": [None]}, r"A.sensors\[0\] must be an object"),
        ({"sensors": {}}, "A.sensors must be a list"),
        ({"sensors": None}, "A.sensors must be a list"),
        ({"sensors": [{}]}, r"A.sensors\[0\].name is missing"),
        (
            {"sensors": [vars(SENSOR)] * (MAX_VARIANT_SENSORS + 1)},
            "A.sensors must hold at most 1000, got 1001",
        ),
        ({"poles": [5]}, r"A.poles\[0\] must be an object"),
        (
            {"poles": [{"name": "p", "position": [0, 1]}]},
            r"A.poles\[0\].position must be 3 numbers, got 2",
        ),
        (
            {"poles": [{"name": "p", "position": [1e300, 0, 0]}]},
            "must lie within 1e.08 m of the origin",
        ),
        ({"poles": [{"name": "p\n", "position": [0, 0, 0]}]}, "a name must be one line"),
        (
            {"poles": [{"name": "p", "position": [0, 0, 0], "tea": 1}]},
            r"A.poles\[0\].tea is unknown",
        ),
        ({"keep_out": 3}, "A.keep_out must be a list"),
        ({"keep_out": [3]}, "A.keep_out: an area needs three corners or more"),
        ({"tea": 3}, "A.tea is unknown"),
    ],
)
def test_a_variant_that_does_not_fit_is_refused_with_the_place(change, said):
    with pytest.raises(ValueError, match=said):
        Variant.from_dict({"sensors": [], "poles": [], **change}, "A")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("name", 3, "name must be a text"),
        ("name", "", "a name must be one line of 1 to 60 characters"),
        ("name", "x" * (MAX_NAME_LENGTH + 1), "a name must be one line"),
        ("model", None, "model must be a text"),
        ("x", "1", "x must be a finite number"),
        ("x", 1e9, "x must be from -1e.08 to 1e.08"),
        ("height", True, "height must be a finite number"),
        ("heading", MAX_TURN_RAD + 1, "heading must be from -1000 to 1000"),
        ("heading", -MAX_TURN_RAD - 1, "heading must be from -1000 to 1000"),
        ("tilt", float("nan"), "tilt must be a finite number"),
        ("locked", 1, "locked must be true or false"),
        ("tea", 1, "tea is unknown"),
    ],
)
def test_a_sensor_that_does_not_fit_is_refused_with_its_member(key, value, said):
    with pytest.raises(ValueError, match=rf"sensors\[0\](\.|: ){said}"):
        Variant.from_dict({"sensors": [{**vars(SENSOR), key: value}], "poles": []})


def test_names_and_areas_have_bounds():
    assert check_name("x" * MAX_NAME_LENGTH) == "x" * MAX_NAME_LENGTH
    assert check_keep_out([[0, 0], [1, 0], [0, 1]]) == ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    for wrong in (
        SQUARE[:2],
        ((0, 0), (4, 4), (4, 0), (0, 4)),
        (*SQUARE[:3], (0, 1e300)),
        [[0], [1], [2]],
        ["abc"] * 3,
    ):
        with pytest.raises(
            ValueError, match=r"three corners or more \(x, y\), and no edge may cross another"
        ):
            check_keep_out(wrong)


def test_a_free_name_goes_on_from_its_number():
    variant = Variant(
        (
            SENSOR,
            replace(SENSOR, name="cam 2"),
            replace(SENSOR, name="cam 3"),
            replace(SENSOR, name="7"),
        )
    )
    assert free_name(variant, "b") == "b"
    assert free_name(variant, "a") == "a 2"
    assert free_name(variant, "cam 2") == "cam 4"
    assert free_name(variant, "7") == "7 2"
    assert len(free_name(variant, "x" * 200)) == MAX_NAME_LENGTH


def test_names_on_a_pole_with_a_long_name_can_be_read_again():
    pole = "p" * 200
    variant = Variant()
    for _ in range(28):  # more than there are letters
        sensor = replace(SENSOR, name=name_on_pole(variant, pole))
        variant = replace(variant, sensors=(*variant.sensors, sensor))
    again = Variant.from_dict(variant.as_dict())
    assert again.sensors == variant.sensors
    assert len({sensor.name for sensor in again.sensors}) == 28


def test_a_sensor_is_placed_on_the_nearest_pole_or_on_one_of_its_own(yard):
    near, far = hang(X + SNAP_M, Y, name="near"), hang(200.0, 300.0, name="far")
    rich = replace(STOCK, mounts=(replace(STOCK.mounts[0], price=7.0), *STOCK.mounts[1:]))
    yard = Yard(SITE, rich)
    variant = yard.place([near, far, replace(far, name="far")])
    assert [sensor.mount for sensor in variant.sensors] == [POLE.name, "own pole 1", "own pole 1"]
    assert [sensor.name for sensor in variant.sensors] == ["near", "far", "far 2"]
    (pole,) = variant.poles
    assert (pole.price, pole.origin) == (7.0, "drawn")
    assert pole.position == pytest.approx(
        [200.0, 300.0, float(SITE.ground(np.array([200.0, 300.0])))]
    )
    sensor = variant.sensors[0]
    assert (sensor.x, sensor.y) == (X + SNAP_M, Y)
    assert (sensor.height, sensor.heading, sensor.tilt) == pytest.approx((5.0, 0.0, 0.3))
    beyond = yard.place([hang(X + SNAP_M + 0.01, Y), hang(X - 90, Y + 90)])
    assert [sensor.mount for sensor in beyond.sensors] == ["own pole 1", "own pole 2"]


def test_a_yard_takes_models_and_poles_of_what_hangs_already():
    lidar = SpinningLidar(channels=16)
    few = pool(SITE, mounts=STOCK.mounts[:5])
    priced = replace(few, axes=replace(few.axes, prices=(3.0,)))
    x, y, _ = STOCK.mounts[9].position.tolist()
    hung = [hang(name="one", model=lidar), hang(name="two"), hang(x, y, name="three")]
    yard = Yard.from_stock(SITE, priced, hung, ())
    assert yard.stock.axes.prices == (3.0, 0.0)
    assert list(yard.models.values()) == [STOCK.axes.models[0], lidar]
    assert yard.mounts[POLE.name].max_sensors == 2
    assert yard.mounts[STOCK.mounts[9].name].max_sensors == 1
    assert len(yard.mounts) == 6
    assert yard.name_model(lidar) == "spinning-lidar"
    with pytest.raises(ValueError, match="the stock has no DepthCamera"):
        yard.name_model(DepthCamera(width=99))
    twice = Yard.from_stock(SITE, STOCK, [hang(model=DepthCamera(width=99, height=90))], ())
    assert list(twice.models) == ["depth-camera", "depth-camera 2"]
    assert twice.stock.axes.prices == ()


def test_a_project_may_say_only_what_can_hang(yard):
    low, high = POLE.min_height, POLE.max_height
    for height in (low, high):
        assert yard.check(Variant((replace(SENSOR, height=height),)))
    yard.check(Variant((replace(SENSOR, x=X + SNAP_M, tilt=np.pi / 2),)))
    yard.check(Variant((replace(SENSOR, tilt=-np.pi / 2),)))
    for change, said in (
        (
            {"height": high + 0.01},
            f"a hangs {high + 0.01:g} m up, but {POLE.name} takes {low:g} to {high:g} m",
        ),
        ({"height": low - 0.01}, "m up, but"),
        ({"height": 6000.0}, "a hangs 6000 m up"),
        ({"x": X + 20.0}, f"a hangs 20 m from its pole {POLE.name}, more than 1.5 m"),
        ({"y": Y - SNAP_M - 0.01}, "m from its pole"),
        ({"tilt": np.pi / 2 + 0.01}, "a is tilted by 90.57 degrees, more than 90"),
        ({"tilt": -2.0}, "more than 90"),
        ({"mount": "moon"}, "there is no pole 'moon'"),
        ({"model": "eye"}, "there is no model 'eye': the stock has depth-camera"),
    ):
        with pytest.raises(ValueError, match=said):
            yard.check(Variant((replace(SENSOR, **change),)))
    with pytest.raises(ValueError, match="names of sensors must differ, got a, a"):
        yard.check(Variant((SENSOR, SENSOR)))


def test_a_sensor_that_hangs_higher_than_its_pole_takes_may_stay(yard):
    high = hang(height=11.0, name="high")
    tall = Yard.from_stock(replace(SITE, sensors=(high,)), STOCK, [high], ())
    (sensor,) = tall.place([high]).sensors
    assert sensor.mount == POLE.name
    tall.check(Variant((sensor, replace(SENSOR, height=9.0))))
    with pytest.raises(ValueError, match="takes 3 to 11 m"):
        tall.check(Variant((replace(sensor, height=11.1),)))


def test_a_pole_of_a_project_stands_at_the_site(yard):
    _, ymin, xmax, ymax = SITE.area.tolist()
    middle = (ymin + ymax) / 2
    pole = Mount("own pole 1", np.array([xmax + MAX_DRAWN_POLE_DISTANCE_M, middle, 0.0]))
    yard.check(Variant((), (pole,)))
    with pytest.raises(
        ValueError, match="own pole 1 stands 101 m from the detection area, more than 100 m"
    ):
        yard.check(
            Variant(
                (),
                (
                    replace(
                        pole, position=np.array([xmax + MAX_DRAWN_POLE_DISTANCE_M + 1, middle, 0.0])
                    ),
                ),
            )
        )
    with pytest.raises(
        ValueError, match="own pole 1 has its foot at z = 25 m, but the ground is at"
    ):
        yard.check(Variant((), (replace(pole, position=np.array([xmax, middle, 25.0])),)))
    for poles in ((pole, pole), (replace(pole, name=POLE.name),)):
        with pytest.raises(ValueError, match="names of poles must differ"):
            yard.check(Variant((), poles))
    away = hang(xmax + 300.0, middle, name="away")
    lone = Yard.from_stock(replace(SITE, sensors=(away,)), STOCK, [away], ())
    lone.check(lone.place([away]))


def test_where_a_pole_may_stand_is_said(yard):
    _, _, xmax, _ = SITE.area.tolist()
    lane = shapely.Polygon(SITE.lanes[0])
    inside = lane.representative_point()
    assert yard.refusal_reason((inside.x, inside.y)) == "it is on a lane"
    assert yard.refusal_reason((xmax + MAX_DRAWN_POLE_DISTANCE_M + 1, 0.0)).startswith(
        "it is more than 100 m from the detection area"
    )
    solid = next(
        each for each in SITE.solids if each.kind in ("building", "wall", "hedge", "tree", "trunk")
    )
    middle = shapely.Polygon(solid.footprint).representative_point()
    assert yard.refusal_reason((middle.x, middle.y)) in (
        "something stands there",
        "it is on a lane",
    )
    kept = replace(yard, keep_out=(shapely.Polygon(SQUARE).buffer(30),))
    assert kept.refusal_reason((2.0, 30.0)) != ""
    variant = Variant(
        keep_out=(
            (
                (X + KERB_GAP_M / 2, Y - 5),
                (X + 5, Y - 5),
                (X + 5, Y + 5),
                (X + KERB_GAP_M / 2, Y + 5),
            ),
        )
    )
    assert variant.keeps_out(POLE)
    away = tuple((x + KERB_GAP_M, y) for x, y in variant.keep_out[0])
    assert not Variant(keep_out=(away,)).keeps_out(POLE)
    with pytest.raises(ValueError, match=f"{POLE.name} cannot be used: it is a keep-out area"):
        yard.find_or_add_pole(variant, POLE.name)
    with pytest.raises(
        ValueError, match=f"no pole can stand at {inside.x:.1f}, {inside.y:.1f}: it is on a lane"
    ):
        yard.find_or_add_pole(Variant(), (inside.x, inside.y))
    mount, after = yard.find_or_add_pole(Variant(), (X + 0.5, Y))
    assert (mount.name, after) == (POLE.name, Variant())
    with pytest.raises(ValueError, match=r"there is no pole 'moon': .* and others are there"):
        yard.find_mount(Variant(), "moon")


def test_candidates_of_a_variant_are_on_their_poles(yard):
    variant = yard.place(SITE.sensors)
    candidates = yard.candidates(variant)
    assert [candidates.mounts[m].name for m in candidates.mount] == [
        sensor.mount for sensor in variant.sensors
    ]
    np.testing.assert_allclose(
        [s.pose for s in candidates.sensors], [s.pose for s in SITE.sensors], atol=1e-9
    )
    heights = [sensor.height for sensor in variant.sensors]
    assert candidates.axes.heights.tolist() == heights
    assert len(yard.candidates(Variant())) == 0
    assert variant.find("d1").name == "d1"
    with pytest.raises(ValueError, match="there is no sensor 'x': the sensors are d0, d1"):
        variant.find("x")
    with pytest.raises(ValueError, match="the sensors are none"):
        Variant().find("x")
