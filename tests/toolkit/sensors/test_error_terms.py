from dataclasses import replace

import numpy as np
import pytest

from toolkit.boxes import points_in_boxes
from toolkit.geometry import check_pose
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.sensors.error_terms import (
    Calibration,
    ClockOffset,
    DeadRows,
    DropOut,
    Glass,
    MixedPixels,
    OwnNoise,
    Paint,
    PoleSway,
    RangeNoise,
    Weather,
    chance_of_return,
    fog,
    lidar_noise,
    make_rotation,
    rain,
    snow,
    stereo_noise,
    time_of_flight_noise,
)
from toolkit.sensors.readings import Draws, Reading
from toolkit.sensors.track_velocities import velocities


def moved(objects, by):
    boxes = objects.boxes.copy()
    boxes[:, :3] += by
    return Objects(boxes, objects.labels, objects.ids)


def test_velocities_of_tracks_and_the_window_band_of_cars(street):
    now, speed = street.objects, np.array([[10.0, 0, 0], [0, -5, 0], [1, 1, 0], [0, 0, 0]])
    before, after = (moved(now, speed * t) for t in (-0.1, 0.1))
    assert np.allclose(velocities(now, 4.0, [(before, 3.9), (after, 4.1)]), speed)
    one = velocities(now, 4.0, [(after[[3, 0]], 4.1)])
    assert np.allclose(one, [[10, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert np.allclose(velocities(now, 4.0, [(before[[1]], 3.9), (after, 4.1)]), speed)
    band, share = Glass(1.0).band(street), heights(street)
    expected = (street.owners >= 0) & (street.owners < 2) & (share > 0.62) & (share < 0.93)
    assert np.array_equal(band, expected)
    assert band.sum() > 300


@pytest.mark.parametrize("times", [(), (5.0,), (3.9, 9.0), (4.0,)])
def test_frames_far_apart_do_not_say_velocities(street, times):
    with pytest.raises(
        ValueError,
        match=r"velocities need frames at most 0.5 s apart, got .*leave the clock's offset",
    ):
        velocities(street.objects, 4.0, [(street.objects, time) for time in times])


def test_points_on_a_car_move_with_its_velocity_and_drops_stay(read, street):
    speed = np.array([[10.0, 2, 0], [0, 0, 0], [-4, 0, 0], [0, 0, 0]])
    said = read(ClockOffset(0.02), replace(street, velocities=speed))
    late = np.random.default_rng([0, 1, 5, 1]).standard_normal() * 0.02
    for row in range(4):
        assert np.allclose(said.shift[street.owners == row], speed[row] * late, atol=1e-6)
    assert not said.shift[street.owners < 0].any()
    assert said.measurement is street.measurement
    again = read(ClockOffset(0.02), replace(street, velocities=speed), frame=99)
    assert np.array_equal(again.shift, said.shift)  # constant over a recording
    speed = np.full((4, 3), 10.0)
    near = np.where(street.owners == 0, np.float32(2.0), street.measurement)

    reading = replace(Reading.from_truth(replace(street, velocities=speed)), measurement=near)
    said = ClockOffset(0.05).apply(reading, Draws(0, 1, 2, 3))
    assert said.shift is not None
    assert not said.shift[street.owners == 0].any()
    assert said.shift[street.owners == 1].any()


def test_it_needs_velocities_unless_it_has_no_strength(read, harmless, street):
    assert ClockOffset().needs_velocities
    harmless(ClockOffset(), street)
    with pytest.raises(ValueError, match="needs the objects' velocities"):
        read(ClockOffset(0.01), street)
    with pytest.raises(ValueError, match="offset of ClockOffset"):
        ClockOffset(-1.0)


def test_returns_fail_by_range_and_power():
    """p = 1/2 where rho · cos · (half / R)² = 1; twice the range or a quarter of the power is the
    same."""
    one = np.ones(1)
    assert chance_of_return(80 * one, one, 80.0, 2.0)[0] == 0.5
    assert chance_of_return(40 * one, 0.25 * one, 80.0, 3.0)[0] == pytest.approx(0.5)
    assert chance_of_return(40 * one, one, 80.0, 3.0, 0.25)[0] == pytest.approx(0.5)
    assert chance_of_return(160 * one, one, 80.0, 2.0)[0] == pytest.approx(1 / 17)
    falling = chance_of_return(np.linspace(1, 300, 50), np.full(50, 0.7), 100.0, 2.0)
    assert (np.diff(falling) < 0).all()
    assert falling[0] > 0.9999
    assert falling[-1] < 0.02
    assert chance_of_return(one, 0 * one, 80.0, 2.0)[0] < 1e-6


def test_stereo_and_time_of_flight_noise_follow_their_laws():
    # f = 800 pixels and B = 0.5 m: at 20 m one tenth of a pixel is 10 cm.
    assert stereo_noise(baseline=0.5, focal=800.0).quadratic * 20**2 == pytest.approx(0.1)
    with pytest.raises(ValueError, match="above 0"):
        stereo_noise(baseline=0.0, focal=800.0)
    for ambient in (0.0, 0.3, 1.0):
        term = time_of_flight_noise(at_10_m=0.05, ambient=ambient)
        assert term.proportional * 10 + term.quadratic * 100 == pytest.approx(0.05)
        assert term.quadratic * 100 == pytest.approx(0.05 * ambient)
    with pytest.raises(ValueError, match="share"):
        time_of_flight_noise(ambient=1.5)


def test_rotations_turn_about_their_vector():
    rng = np.random.default_rng(0)
    for _ in range(50):
        vector = rng.normal(size=3)
        turned = make_rotation(vector)
        assert np.allclose(turned @ turned.T, np.eye(3))
        assert np.linalg.det(turned) == pytest.approx(1)
        assert np.allclose(turned @ vector, vector)
        assert np.trace(turned) == pytest.approx(1 + 2 * np.cos(np.linalg.norm(vector)))
        assert np.allclose(turned @ make_rotation(-vector), np.eye(3))
    assert np.array_equal(make_rotation(np.zeros(3)), np.eye(3))


def test_rain_snow_and_fog_have_published_extinctions():
    # dB per km: rain of 10 mm/h 5.03, dry snow of 1 mm/h 5.55, wet 3.88; fog of 100 m visibility
    # 0.039 per
    # metre.
    per_km = 10 / np.log(10) * 1000
    assert rain(10.0).extinction * per_km == pytest.approx(1.076 * 10**0.67)
    assert rain(10.0).extinction * per_km == pytest.approx(5.03, abs=0.01)
    assert snow(1.0).extinction * per_km == pytest.approx(5.545, abs=0.01)
    assert snow(1.0, wet=True).extinction * per_km == pytest.approx(3.878, abs=0.01)
    assert fog(100.0).extinction == pytest.approx(0.03912)
    assert rain(10.0).share == pytest.approx(1 - np.exp(-0.03))
    assert fog(50.0).reach == 5.0
    shares = [rain(r).share for r in (0.0, 1.0, 10.0, 100.0)]
    assert shares == sorted(shares)
    assert shares[0] == 0
    for wrong in (lambda: rain(-1.0), lambda: snow(float("nan")), lambda: fog(0.0)):
        with pytest.raises(ValueError, match="must be"):
            wrong()


@pytest.mark.parametrize("share", [0.02, 0.4])
def test_the_share_that_drops_out(read, wall, sensor, share):
    said = read(DropOut(share), wall(sensor, 30.0))
    assert 1 - said.valid.mean() == pytest.approx(share, rel=0.12)
    assert set(np.unique(said.measurement)) == {0.0, 30.0}


def test_shares_and_ranges_take_pixels_and_edges_mix_what_is_read(read, street):
    term = DropOut(half_range=25.0)
    lost = np.mean([~read(term, street, frame=f).valid[street.valid] for f in range(12)], axis=0)
    expected = 1 - chance_of_return(street.ranges, street.cosines, 25.0, 2.0)[street.valid]
    for low, high in ((0, 0.2), (0.2, 0.6), (0.6, 0.9), (0.9, 1)):
        some = (expected >= low) & (expected < high)
        assert some.sum() > 100
        assert lost[some].mean() == pytest.approx(expected[some].mean(), abs=0.02)
    nothing = replace(street, measurement=np.zeros_like(street.measurement))
    assert not read(DropOut(0.5, 40.0), nothing).measurement.any()
    # Edges of returns that an earlier term took are none.
    said = read(MixedPixels(1.0), street).measurement
    assert (said != street.measurement).mean() > 0.005
    assert not said[~street.valid].any()


def test_shares_and_laws_are_of_some_sensors(read, wall, sensor):
    truth = wall(sensor, 50.0)
    kept = read(DropOut(0.5, half_range=50.0), truth).valid.mean()
    assert kept == pytest.approx(
        0.5 * chance_of_return(truth.ranges, truth.cosines, 50.0, 2.0).mean(), rel=0.06
    )
    truth = wall(sensor, 10.0)
    said = [read(DeadRows(0.25), truth, frame=frame).valid for frame in (0, 1, 77)]
    assert all(np.array_equal(each, said[0]) for each in said)
    whole = said[0].all(axis=1)
    assert np.array_equal(~whole, ~said[0].any(axis=1))
    shares = [read(DeadRows(0.25), truth, number=n).valid.mean() for n in range(300)]
    assert np.mean(shares) == pytest.approx(0.75, abs=0.01)
    assert len(set(shares)) > 5
    assert not read(DeadRows(1.0), truth).valid.any()
    truth = wall(sensor, 10.0)
    laws = {"depth": stereo_noise(baseline=1.0, focal=1000.0), "range": lidar_noise()}
    for measures, term in laws.items():
        same = np.array_equal(read(term, truth).measurement, truth.measurement)
        assert same == (measures != sensor.model.measures)
    truth = wall(sensor, 40.0)
    kept = read(Weather(extinction=0.01), truth).valid.mean()
    assert kept == pytest.approx(np.exp(-0.02 * truth.ranges).mean(), abs=0.012)


@pytest.fixture
def halves(wall, sensor):
    """Left of the middle 10 m, right of it 20 m."""
    truth = wall(sensor, 10.0)
    truth.measurement[:, truth.measurement.shape[1] // 2 :] = 20.0
    return truth


def test_edges_mix_between_and_within_bounds(read, halves):
    image = np.stack([read(MixedPixels(0.6), halves, frame=f).measurement for f in range(40)])
    changed = image != halves.measurement
    middle = image.shape[2] // 2
    assert set(np.flatnonzero(changed.any(axis=(0, 1)))) == {middle - 1, middle}
    assert changed[..., middle - 1 : middle + 1].mean() == pytest.approx(
        0.6 / 4, rel=0.1
    )  # one neighbour of four
    between = image[changed]
    assert between.min() > 10
    assert between.max() < 20
    assert between.mean() == pytest.approx(15.0, abs=0.25)
    assert between.std() == pytest.approx(10 / np.sqrt(12), rel=0.06)
    for still in (MixedPixels(1.0, gap=10.5), MixedPixels(1.0, reach=9.5)):
        assert np.array_equal(read(still, halves).measurement, halves.measurement)
    assert (
        read(MixedPixels(1.0, gap=9.5, reach=10.5), halves).measurement != halves.measurement
    ).any()
    image = np.where(halves.measurement > 15, np.float32(0), halves.measurement)
    assert np.array_equal(
        read(MixedPixels(1.0), replace(halves, measurement=image)).measurement, image
    )


def angle_between(a, b):
    return np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))


def test_calibration_has_its_root_mean_square(read, street):
    term, true = Calibration(0.01, 0.05), np.linalg.inv(street.sensor.pose)
    errors = np.array([true @ read(term, street, number=n).pose for n in range(800)])
    moves = errors[:, :3, 3]
    turns = np.stack([errors[:, 2, 1], errors[:, 0, 2], errors[:, 1, 0]], axis=1)  # to first order
    assert np.allclose(moves.std(axis=0), 0.05 / 3**0.5, rtol=0.08)
    assert np.allclose(turns.std(axis=0), 0.01 / 3**0.5, rtol=0.08)
    angles = np.array([angle_between(each, np.eye(4)) for each in errors])
    assert np.sqrt((angles**2).mean()) == pytest.approx(0.01, rel=0.04)
    assert np.sqrt((moves**2).sum(axis=1).mean()) == pytest.approx(0.05, rel=0.04)
    assert np.abs(moves.mean(axis=0)).max() < 0.007
    assert np.abs(turns.mean(axis=0)).max() < 0.0014


def test_calibration_is_constant_and_scales(read, street):
    said = [read(Calibration(0.01, 0.05), street, frame=frame) for frame in (0, 1, 900)]
    assert all(np.array_equal(each.pose, said[0].pose) for each in said)
    assert all(each.measurement is street.measurement for each in said)
    check_pose(said[0].pose)
    doubled = read(Calibration(0.02, 0.1), street).pose
    single = said[0].pose
    assert angle_between(doubled, street.sensor.pose) == pytest.approx(
        2 * angle_between(single, street.sensor.pose)
    )
    assert np.allclose(
        doubled[:3, 3] - street.sensor.position, 2 * (single[:3, 3] - street.sensor.position)
    )
    assert not np.array_equal(read(Calibration(0.01, 0.05), street, number=6).pose, single)


def test_poles_sway_along_a_line(read, street):
    term = PoleSway(0.004, 3.0)
    height, rest = street.sensor.position[2], street.sensor.pose
    angles, moves = [], []
    for time in np.linspace(0, 60, 400):
        pose = read(term, replace(street, time=float(time))).pose
        check_pose(pose)
        angles.append(angle_between(pose, rest))
        moves.append(pose[:3, 3] - rest[:3, 3])
        assert np.linalg.norm(moves[-1]) == pytest.approx(2 / 3 * height * angles[-1], abs=1e-6)
    tips = np.array(moves)
    assert max(angles) == pytest.approx(0.004, rel=0.01)
    assert min(angles) < 4e-4
    assert not tips[:, 2].any()
    assert np.linalg.matrix_rank(tips, tol=1e-9) == 1
    crossings = int((np.diff(np.sign(tips @ tips[np.abs(tips).sum(axis=1).argmax()])) != 0).sum())
    assert 60 / 4.0 * 2 - 1 <= crossings <= 60 / 2.0 * 2 + 1  # two a period of 2 to 4 s


def test_sensors_of_one_pole_sway_together(read, street):
    other = replace(street.sensor, name="other")
    said = [
        read(PoleSway(0.004), replace(street, sensor=s), number=n).pose
        for n, s in ((1, street.sensor), (2, other))
    ]
    assert np.array_equal(*said)


def test_noise_is_drawn_anew_for_frame_seed_and_sensor(read, street):
    noise = RangeNoise(constant=0.1)
    drawn = [
        read(noise, street, **with_).measurement.tobytes()
        for with_ in ({}, {"frame": 4}, {"seed": 1}, {"number": 6}, {})
    ]
    assert drawn[0] == drawn[4]
    assert len(set(drawn)) == 4
    own = read(OwnNoise(), street)
    assert (own.measurement - street.measurement)[street.valid].std() == pytest.approx(
        0.015, rel=0.02
    )


@pytest.mark.parametrize("metres", [5.0, 20.0, 60.0])
@pytest.mark.parametrize(
    "term",
    [
        RangeNoise(constant=0.03),
        RangeNoise(0.01, 0.002),
        RangeNoise(quadratic=1e-4),
        time_of_flight_noise(),
    ],
)
def test_sigma_by_range(read, wall, sensor, term, metres):
    noise = read(term, wall(sensor, metres)).measurement.astype(np.float64) - metres
    expected = term.constant + term.proportional * metres + term.quadratic * metres**2
    assert noise.std() == pytest.approx(expected, rel=0.03)
    assert abs(noise.mean()) < 4 * expected / np.sqrt(noise.size)


def test_what_returned_nothing_still_does_and_nothing_comes_from_behind(read, street, wall, sensor):
    assert not read(RangeNoise(constant=1.0), street).measurement[~street.valid].any()
    wild = read(RangeNoise(constant=30.0), wall(sensor, 10.0)).measurement
    assert (wild >= 0).all()
    assert wild.dtype == np.float32


def heights(truth):
    """Share of its object's height at which each pixel lies."""
    boxes = truth.objects.boxes[truth.owners]
    return (truth.points[:, 2].reshape(truth.owners.shape) - boxes[..., 2]) / boxes[..., 5] + 0.5


def test_dark_pillars_and_glass(read, street):
    said = read(Glass(1.0, behind=0.4), street)
    band = Glass(1.0).band(street)
    assert np.array_equal(said.measurement[~band], street.measurement[~band])
    through = said.valid & band
    assert through.sum() / band.sum() == pytest.approx(0.4, abs=0.06)
    deeper = said.measurement[through] - street.measurement[through]
    assert (deeper >= 0).all()
    assert deeper.mean() > 0.3
    inside = replace(street, measurement=said.measurement).points[np.flatnonzero(through)]
    boxes = street.objects.boxes + np.array([0, 0, 0, 0.02, 0.02, 0.02, 0])
    assert points_in_boxes(inside, boxes[:2]).any(axis=1).all()
    band = Glass(1.0).band(street)
    lost = ~read(Glass(0.7, behind=0.0), street).valid & band
    assert lost.sum() / band.sum() == pytest.approx(0.7, abs=0.06)


def test_the_way_through_a_car_is_that_to_its_far_side(read, street):
    """Oracle: at most where the ray leaves the box, found by steps of a centimetre."""
    said = [read(Glass(1.0, behind=1.0), street, frame=f).measurement for f in range(60)]
    for row, column in np.argwhere(Glass(1.0).band(street))[::40]:
        pixel = row * street.measurement.shape[1] + column
        ray = street.sensor.world_rays[:, pixel].astype(np.float64)
        steps = street.measurement[row, column] + np.arange(0, 8, 0.01)
        box = street.objects.boxes[[street.owners[row, column]]] + np.array(
            [0, 0, 0, 0.002, 0.002, 0.002, 0]
        )
        within = points_in_boxes(street.sensor.position + steps[:, None] * ray, box)[:, 0]
        leaves = steps[np.flatnonzero(within)[-1]]
        farthest = max(image[row, column] for image in said)
        entry = street.measurement[row, column]
        assert entry <= farthest <= leaves + 0.02
        assert farthest >= entry + 0.8 * (leaves - entry) - 0.02


def test_dark_cars_lose_more_and_open_rays_return_a_share(read, street, sensor):
    many = np.arange(400)
    boxes = np.column_stack(
        [20 + 0 * many, 0 * many, *np.tile([[0.75], [4], [2], [1.5], [0]], 400)]
    )
    crowd = Objects(boxes, np.full(400, VEHICLE), many)
    owners = np.resize(np.arange(400), street.measurement.shape)
    at_30 = np.full(street.measurement.shape, 30.0, np.float32)
    truth = replace(street, objects=crowd, measurement=at_30)
    vars(truth)["owners"] = owners
    term = Paint(0.3, dark=0.02, half_range=60.0)
    lost = [
        np.bincount(owners.ravel(), (~read(term, truth, number=n, frame=n).valid).ravel())
        for n in (1, 2)
    ]
    dark = [each > 0 for each in lost]
    assert np.array_equal(*dark)
    assert dark[0].mean() == pytest.approx(0.3, abs=0.07)
    assert lost[0].sum() > 1000
    sky = replace(street, sensor=sensor, measurement=np.zeros(sensor.model.shape, np.float32))
    said = read(Weather(share=0.3, reach=4.0), sky)
    assert said.valid.mean() == pytest.approx(0.3, abs=0.012)
    assert np.percentile(ranges_of(said)[said.valid], 90) < 12


def test_wetness_and_rain_take_more_by_the_law(read, street):
    """All vehicles at a fifth of their reflectivity: what stays is the ratio of both chances."""
    term = Paint(0.0, wet=0.2, half_range=30.0)
    kept = np.mean([read(term, street, frame=f).valid for f in range(30)], axis=0)
    law = street.ranges, street.cosines, 30.0, 2.0
    expected = chance_of_return(*law, 0.2) / chance_of_return(*law)
    painted = np.isin(
        street.owners, np.flatnonzero(np.isin(street.objects.labels, (VEHICLE, HEAVY)))
    )
    assert kept[painted].mean() == pytest.approx(expected[painted].mean(), abs=0.01)
    assert kept[painted].mean() < 0.8
    others = street.valid & ~painted
    assert (kept[others] == 1).all()
    # Metamorphic: whatever a light rain takes or brings, a heavier one does too, since both draw
    # the same
    # numbers.
    light, heavy = (read(rain(r), street) for r in (5.0, 50.0))
    changed = [each.measurement != street.measurement for each in (light, heavy)]
    assert not (changed[0] & ~changed[1]).any()
    assert changed[0].sum() < changed[1].sum()


def ranges_of(said):
    return said.measurement * said.truth.ray_lengths


@pytest.mark.parametrize("metres", [3.0, 10.0, 60.0])
def test_near_returns_have_the_law_of_range(read, wall, sensor, metres):
    """P(return before R) = 1 - (1 - share)^(1 - exp(-(R - 0.3) / reach)), so also of those before
    each r < R."""
    term, truth = Weather(share=0.5, reach=6.0), wall(sensor, metres)
    said = ranges_of(read(term, truth))
    early = said < truth.ranges - 1e-4
    for r in (1.0, 2.0, 5.0, 9.0, 40.0):
        if r < metres:
            expected = 1 - 0.5 ** (1 - np.exp(-(r - 0.3) / 6.0))
            assert (early & (said < r)).mean() == pytest.approx(expected, abs=0.012)
    assert said[early].min() > 0.29


@pytest.mark.parametrize(
    "term",
    [
        *(
            DropOut(),
            DeadRows(),
            MixedPixels(),
            MixedPixels(0.0, gap=0.0),
            Calibration(),
            PoleSway(),
            RangeNoise(),
        ),
        *(Glass(), Paint(), Weather(), rain(0.0), ClockOffset()),
    ],
)
def test_no_strength_no_change(harmless, street, term):
    harmless(term, street)


def test_paint_without_objects_changes_nothing(harmless, street):
    harmless(Paint(0.5), replace(street, objects=Objects.empty()))


@pytest.mark.parametrize(
    ("term", "wrong", "says"),
    [
        (DropOut, {"share": -0.1}, "share of DropOut must be a share from 0 to 1, got -0.1"),
        *(
            (DropOut, {"half_range": -1.0}, "must be a number from 0"),
            (DeadRows, {"share": 1.1}, "must be a share"),
        ),
        (MixedPixels, {"share": 1.5}, "must be a share"),
        (MixedPixels, {"gap": -1.0}, "gap of MixedPixels must be a number"),
        (Calibration, {"rotation": -0.1}, "must be a number from 0"),
        (Calibration, {"translation": np.inf}, "must be a number from 0"),
        (PoleSway, {"period": 0.0}, "must be a number from 0.001"),
        (RangeNoise, {"constant": -1.0}, "must be a number from 0"),
        (RangeNoise, {"quadratic": np.nan}, "must be a number from 0"),
        *(
            (Glass, {"lower": 0.9, "upper": 0.8}, "lower < upper"),
            (Glass, {"share": 2.0}, "must be a share"),
        ),
        *(
            (Paint, {"dark": -1.0}, "must be a share"),
            (Paint, {"half_range": 0.0}, "must be a number from 0.001"),
        ),
        *(
            (Weather, {"share": 1.0}, "below 1"),
            (Weather, {"extinction": -1.0}, "must be a number from 0"),
        ),
        (Weather, {"reach": 0.0}, "must be a number from 0.001"),
    ],
)
def test_wrong_numbers_are_refused(term, wrong, says):
    with pytest.raises(ValueError, match=says):
        term(**wrong)
