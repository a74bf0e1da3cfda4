"""The doctor reads each layout and names what is wrong in its files; the whole table is that of
bench_doctor."""

import importlib.util
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from toolkit.calibration.ground import level
from toolkit.datasets import problem_kinds
from toolkit.datasets.box_frames import move_boxes
from toolkit.datasets.recordings import LAYOUTS, open_recording
from toolkit.doctor import box_fits, diagnosis
from toolkit.doctor.box_fits import MIN_BOX_POINTS, GroundView, fits, fits_better, measure_fits
from toolkit.doctor.label_headings import count_turned
from toolkit.doctor.label_mistake import possible_headings, undo_mistake
from toolkit.doctor.label_mistakes import LABEL_MISTAKES, YAW_SIGN
from toolkit.doctor.label_shifts import find_shift
from toolkit.doctor.labels import diagnose_labels
from toolkit.doctor.moving_boxes import find_moving
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Objects

BOX = np.array([[10.0, 0, 1.0, 4, 2, 2, 0.0]])


def face(x, count=40, z=(0.5, 1.5)):
    """Points on a wall across x."""
    return np.column_stack(
        [np.full(count, x), np.linspace(-0.9, 0.9, count), np.linspace(*z, count)]
    )


def test_points_fit_faces_better_than_chance():
    hollow, turned = face(10.0)[np.abs(face(10.0)[:, 1]) < 0.5], BOX + np.eye(7)[6] * np.pi / 2
    for points, fit in (
        *((face(8.0), [1.0]), (hollow, [0.0])),
        (face(7.6), [0.0]),  # in the shell, beside the box
        (np.concatenate([face(8.0), face(7.6)]), [0.5]),
        (np.concatenate([face(8.0), face(7.0)]), [1.0]),  # beyond the shell
        (face(7.91), [1.0]),  # a face may stand out by the slack
        *((face(7.89), [0.0]), (face(8.0, MIN_BOX_POINTS), [1.0])),
        (face(8.0, MIN_BOX_POINTS - 1), [0.0]),  # a box of few points says nothing
    ):
        assert measure_fits(points, BOX).tolist() == fit
    wall = face(9.0)
    assert measure_fits(wall, turned).tolist() == [1.0]  # 1 m ahead and behind, 2 m aside
    assert measure_fits(wall[np.abs(wall[:, 1]) < 0.5], BOX).tolist() == [0.0]
    for before, after, said in (
        (np.zeros(5), np.ones(5), True),
        (np.zeros(4), np.ones(4), False),  # too few
        (np.zeros(20), np.r_[np.ones(4), np.zeros(16)], False),  # four alone have any fit
        (np.full(9, 0.5), np.full(9, 0.515), False),  # hardly any gain
        (np.full(9, 0.5), np.full(9, 0.53), True),
        (np.full(10, 0.5), 0.5 + np.array([0.5, -0.4] * 5), False),  # chance
    ):
        assert fits_better(before, after) is said
    assert not fits_better(np.full(9, 0.5), np.full(9, 0.6), 0.15)
    ground = np.column_stack(
        [np.random.default_rng(0).uniform(-20, 20, (3000, 2)), np.full(3000, 2.0)]
    )
    points = np.concatenate([ground, face(8.0, z=(2.5, 3.5))]).astype(np.float32)
    cloud = SensorCloud("s", points, np.eye(4))
    seen = GroundView.from_frame(
        Frame.of_clouds("0", (cloud,), Objects(BOX + np.array([0, 0, 2.0, 0, 0, 0, 0])))
    )
    assert len(seen.points) == 40
    np.testing.assert_allclose(seen.ground.height(BOX[:, :2]), [2.0], atol=0.02)
    assert fits(
        [seen, seen], [BOX + np.array([0, 0, 2.0, 0, 0, 0, 0]), np.zeros((0, 7))]
    ).tolist() == [1.0]
    nothing = GroundView.from_frame(
        Frame.of_clouds("0", (SensorCloud("s", points[:2], np.eye(4)),), Objects(BOX))
    )
    assert (len(nothing.points), nothing.ground) == (2, None)


BOX_LABEL_MISTAKES = np.array([[3.0, 5.0, 1.0, 4.0, 2.0, 1.5, 0.4]])
OWN_INVERSE = (
    "mirrored",
    "y of the positions",
    "x and y swapped",
    "length and width",
    "yaw counted",
)


@pytest.mark.parametrize("mistake", LABEL_MISTAKES, ids=lambda mistake: mistake.name[:12])
def test_a_mistake_changes_boxes_and_some_undo_themselves(mistake):
    assert not np.allclose(mistake.undo(BOX_LABEL_MISTAKES), BOX_LABEL_MISTAKES)
    again = mistake.undo(mistake.undo(BOX_LABEL_MISTAKES))
    again[:, 6] = np.angle(np.exp(1j * again[:, 6]))
    assert np.allclose(again, BOX_LABEL_MISTAKES) is mistake.name.startswith(OWN_INVERSE)
    assert mistake.axes is (
        mistake.name.startswith(("mirrored", "y of", "x and y", "yaw counted", "yaw in radians"))
    )


def test_mistakes_are_undone_also_in_a_map_and_of_degrees():
    undone = [
        *(
            [3, -5, 1, 4, 2, 1.5, -0.4],
            [-3, 5, 1, 4, 2, 1.5, np.pi - 0.4],
            [3, -5, 1, 4, 2, 1.5, 0.4],
        ),
        *(
            [5, 3, 1, 4, 2, 1.5, np.pi / 2 - 0.4],
            [3, 5, 1, 8, 4, 3, 0.4],
            [3, 5, 1, 2, 1, 0.75, 0.4],
        ),
        *(
            [3, 5, 1, 2, 4, 1.5, 0.4],
            [3, 5, 1, 4, 2, 1.5, -0.4],
            [3, 5, 1, 4, 2, 1.5, np.rad2deg(0.4)],
        ),
    ]
    np.testing.assert_allclose(
        [each.undo(BOX_LABEL_MISTAKES)[0] for each in LABEL_MISTAKES[:9]], undone
    )
    world_SE3_map = invert(pose(600.0, 1600.0, 30.0, yaw=0.7))
    in_map = move_boxes(invert(world_SE3_map), BOX_LABEL_MISTAKES)
    mirrored = LABEL_MISTAKES[0].undo(in_map)
    assert np.abs(move_boxes(world_SE3_map, mirrored)[0, :2]).max() > 1000
    back = undo_mistake(
        LABEL_MISTAKES[0], move_boxes(world_SE3_map, mirrored), invert(world_SE3_map)
    )
    np.testing.assert_allclose(back, BOX_LABEL_MISTAKES, atol=1e-9)
    np.testing.assert_array_equal(
        undo_mistake(YAW_SIGN, BOX_LABEL_MISTAKES, np.eye(4)), YAW_SIGN.undo(BOX_LABEL_MISTAKES)
    )
    for yaw in np.linspace(-1.5, 1.5, 7):
        headings = possible_headings(np.array([np.angle(np.exp(1j * np.rad2deg(yaw)))]))
        assert np.abs(headings - yaw).min() < 1e-9
        assert len(headings) == 31


SPEED = 10.0  # m/s
HEADINGS = np.array([0.0, 0.0, np.pi / 2, np.pi / 2, np.pi / 2, -np.pi / 2])


def driving(count=4, late=0, *, seconds=0.1, ids=True, place=None):
    """Cars that drive along the axes, fronts and backs seen; late: samples that their labels lag
    behind."""
    start = np.column_stack(
        [
            [-20, -15, 0, 5, 10, 15],
            np.zeros(6),
            np.full(6, 1.0),
            np.tile([4, 2, 1.6], (6, 1)),
            HEADINGS,
        ]
    )
    ahead = np.column_stack([np.cos(HEADINGS), np.sin(HEADINGS)])
    made = []
    for k in range(count):
        now, labelled = start.copy(), start.copy()
        now[:, :2] += SPEED * seconds * k * ahead
        labelled[:, :2] += SPEED * seconds * (k - late) * ahead
        aside = np.linspace(-0.9, 0.9, 30)
        faces = [
            np.column_stack(
                [
                    box[0] + end * np.cos(box[6]) - aside * np.sin(box[6]),
                    box[1] + end * np.sin(box[6]) + aside * np.cos(box[6]),
                    np.linspace(0.6, 1.6, 30),
                ]
            )
            for box in now
            for end in (2.0, -2.0)
        ]
        numbers = np.arange(6) if ids else np.arange(6) + 100 * k
        cloud = SensorCloud("s", np.concatenate(faces).astype(np.float32), np.eye(4))
        sample = Frame.of_clouds(
            str(k),
            (cloud,),
            Objects(labelled, ids=numbers),
            time=5 + seconds * k if ids else np.nan,
        )
        made.append(sample if place is None else replace(sample, map_SE3_world=place))
    return made


def seen(samples):
    return [GroundView(sample, sample.points()) for sample in samples]


def test_velocities_are_those_of_tracks():
    boxes, velocities, ids = find_moving(driving(), 1)
    assert ids.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(
        velocities, SPEED * np.column_stack([np.cos(HEADINGS), np.sin(HEADINGS)]), atol=1e-9
    )
    assert len(boxes) == 6
    assert len(find_moving(driving(ids=False), 1).boxes) == 0
    assert len(find_moving(driving(1), 0).boxes) == 0
    assert len(find_moving(driving(seconds=1e-6), 0).boxes) == 6
    still = [replace(each, time=time) for each, time in zip(driving(2), (0.0, 100.0), strict=True)]
    assert len(find_moving(still, 0).boxes) == 0
    # A vehicle that drives as fast as what it looks at: in its frame nothing moves, in the map
    # everything does.
    one, two = driving(2)
    moved = replace(two, objects=one.objects, map_SE3_world=pose(1.0, 0.0, 0.0))
    np.testing.assert_allclose(
        find_moving([one, moved], 0).velocities, np.tile([10.0, 0.0], (6, 1)), atol=1e-9
    )


def test_fronts_that_point_backwards_are_counted():
    def undo(sample, boxes):
        return YAW_SIGN.undo(boxes)

    assert count_turned(wrong(driving()), undo) == (4, 16, 24)
    assert count_turned(driving(), undo) is None
    assert count_turned(wrong(driving(ids=False)), undo) is None
    alone = [each.select_objects(np.arange(3)) for each in wrong(driving(8))]
    assert count_turned(alone, undo) is None  # one car that drives backwards is no mistake of all
    # a mistake that spoils as many is none
    assert (
        count_turned(wrong(driving()), lambda sample, boxes: boxes + np.eye(7)[6] * np.pi) is None
    )


@pytest.mark.parametrize(("late", "behind"), [(1, True), (-1, False), (2, True)])
def test_labels_of_another_time_along_their_tracks(late, behind):
    shift = find_shift(seen(driving(late=late)))
    assert shift is not None
    assert (shift.amount, shift.behind) == (f"{0.1 * abs(late):g} s", behind)
    assert shift.after.mean() == 1.0
    assert shift.before.mean() < 0.5


@pytest.mark.parametrize(
    ("late", "amount", "behind"),
    [(1, "1 sample", True), (-1, "1 sample", False), (2, "2 samples", True)],
)
@pytest.mark.parametrize("place", [None, pose(600.0, 1600.0, 0.0, yaw=0.7)])
def test_labels_of_another_time_without_times_and_tracks(late, amount, behind, place):
    shift = find_shift(seen(driving(6, late, ids=False, place=place)))
    assert shift is not None
    assert (shift.amount, shift.behind) == (amount, behind)


@pytest.mark.parametrize("ids", [True, False])
def test_nothing_is_said_of_labels_of_the_same_time(ids):
    assert find_shift(seen(driving(ids=ids))) is None
    assert find_shift(seen(driving(1, ids=ids))) is None
    assert find_shift([]) is None


def wrong(samples):
    return [
        replace(each, objects=Objects(YAW_SIGN.undo(each.objects.boxes), ids=each.objects.ids))
        for each in samples
    ]


SPEED_DIAGNOSIS = 8.0  # m/s


def hull(box, rng, count=150):
    """Points on the two faces of a box that a lidar at the origin sees, and on its roof's edge."""
    x, y, z, length, width, height, yaw = box
    ends = np.array([[length / 2, 0], [0, width / 2]]) * np.sign(
        -np.array([[x * np.cos(yaw) + y * np.sin(yaw)], [y * np.cos(yaw) - x * np.sin(yaw)]])
    )
    along = rng.uniform(-0.5, 0.5, (count, 2))
    local = np.where(rng.random((count, 1)) < 0.5, [length, 0] * along, [0, width] * along)
    local = local + np.where(local[:, :1] != 0, ends[1], ends[0])
    up = z + rng.uniform(-0.5, 0.5, count) * height
    ahead, aside = local.T
    turned = np.column_stack(
        [ahead * np.cos(yaw) - aside * np.sin(yaw), ahead * np.sin(yaw) + aside * np.cos(yaw)]
    )
    return np.column_stack([turned + np.array([x, y]), up])


def recording(count=2, seconds=0.1, late=0.0, *, ground_points=8000, yaws=None):
    """Cars that drive along their headings on flat ground; late: by how much their labels lag
    behind (s)."""
    rng = np.random.default_rng(1)
    angle, away = np.linspace(0, 2 * np.pi, 14, endpoint=False), rng.uniform(8, 30, 14)
    start = np.column_stack(
        [
            away * np.cos(angle),
            away * np.sin(angle) + 2,
            np.full(14, 0.8),
            rng.uniform(3.8, 5, 14),
            rng.uniform(1.7, 2, 14),
            np.full(14, 1.6),
            rng.uniform(-3, 3, 14),
        ]
    )
    start[:, 6] = start[:, 6] if yaws is None else yaws
    velocity = SPEED_DIAGNOSIS * np.column_stack([np.cos(start[:, 6]), np.sin(start[:, 6])])
    made = []
    for k in range(count):
        now, labelled = start.copy(), start.copy()
        now[:, :2] += velocity * seconds * k
        labelled[:, :2] += velocity * (seconds * k - late)
        ground = np.column_stack(
            [rng.uniform(-45, 45, (ground_points, 2)), rng.normal(0, 0.01, ground_points)]
        )
        points = np.concatenate([ground, *(hull(box, rng) for box in now)]).astype(np.float32)
        objects = Objects(labelled, ids=np.arange(14))
        made.append(
            Frame.of_clouds(
                str(k), (SensorCloud("s", points, np.eye(4)),), objects, time=100 + seconds * k
            )
        )
    return made


def with_boxes(samples, change):
    """The samples with other boxes, as a reader that made the mistake would give them."""
    return [
        replace(
            each, objects=Objects(change(each.objects.boxes), each.objects.labels, each.objects.ids)
        )
        for each in samples
    ]


@pytest.fixture(scope="module")
def sound():
    return recording()


MISTAKES = {
    "mirrored: y": lambda b: b * [1, -1, 1, 1, 1, 1, -1],
    "mirrored: x": lambda b: np.column_stack([-b[:, 0], b[:, 1:6], np.pi - b[:, 6]]),
    "x and y swapped": lambda b: np.column_stack(
        [b[:, 1], b[:, 0], b[:, 2:6], np.pi / 2 - b[:, 6]]
    ),
    "half extents": lambda b: b * [1, 1, 1, 0.5, 0.5, 0.5, 1],
    "doubled extents": lambda b: b * [1, 1, 1, 2, 2, 2, 1],
    "the centre of the floor": lambda b: np.column_stack(
        [b[:, :2], b[:, 2] - b[:, 5] / 2, b[:, 3:]]
    ),
    "the centre of the roof": lambda b: np.column_stack(
        [b[:, :2], b[:, 2] + b[:, 5] / 2, b[:, 3:]]
    ),
    "length and width swapped": lambda b: b[:, [0, 1, 2, 4, 3, 5, 6]],
    "yaw counted the other way": lambda b: b * [1, 1, 1, 1, 1, 1, -1],
    "yaw in radians where degrees": lambda b: np.column_stack([b[:, :6], np.deg2rad(b[:, 6])]),
}


def test_degrees_are_told_from_sound_radians(sound):
    nothing = Frame.of_clouds(
        "0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    for samples in (sound, [], [nothing]):
        assert diagnose_labels(samples) == []
    (finding,) = diagnose_labels([replace(sound[0], problems={"yaws beyond a full turn": 12})])
    assert finding.suspected == "yaw in degrees where radians belong"
    assert "12 of 14 yaws" in finding.evidence
    assert diagnose_labels([replace(sound[0], problems={"yaws beyond a full turn": 2})]) == []
    lost = with_boxes(
        sound, lambda b: np.column_stack([b[:, :6], np.angle(np.exp(1j * np.rad2deg(b[:, 6])))])
    )
    (finding,) = diagnose_labels(lost)
    assert (
        finding.suspected
        == "yaw in degrees where radians belong, of which only sine and cosine are left"
    )
    assert finding.remedy == "multiply yaw by pi / 180 before its sine and cosine are taken"


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_classic_mistake_is_named_alone(sound, mistake):
    (finding,) = diagnose_labels(with_boxes(sound[:1], MISTAKES[mistake]))
    assert finding.suspected.startswith(mistake)
    assert finding.severity == "error"


@pytest.mark.parametrize(("late", "says"), [(0.2, "behind"), (-0.2, "ahead of")])
def test_labels_of_another_time(late, says):
    (finding,) = diagnose_labels(recording(late=late))
    assert finding.suspected == f"labels lie about 0.2 s {says} the clouds"


def test_signs_of_yaw_and_heights_are_seen_where_boxes_belong():
    along = recording(yaws=np.tile([np.pi / 2, -np.pi / 2], 7))
    assert diagnose_labels(along) == []
    (finding,) = diagnose_labels(with_boxes(along, MISTAKES["yaw counted the other way"]))
    assert finding.suspected == "yaw counted the other way round"
    assert finding.evidence == (
        "28 of 28 boxes that move, of 14 objects, head against their way, and along it with that "
        "undone"
    )
    # On a slope, mirrored boxes lie elsewhere, above or below the ground there.
    (flat,) = recording(count=1)
    cloud = flat.clouds[0].points + np.float32(0)
    cloud[:, 2] += 0.1 * cloud[:, 1]
    boxes = flat.objects.boxes + np.column_stack(
        [np.zeros((14, 2)), 0.1 * flat.objects.boxes[:, 1], np.zeros((14, 4))]
    )
    sloped = replace(
        flat.with_clouds((replace(flat.clouds[0], points=cloud),)), objects=Objects(boxes)
    )
    assert diagnose_labels([sloped]) == []
    (finding,) = diagnose_labels(with_boxes([sloped], MISTAKES["mirrored: y"]))
    assert finding.suspected.startswith("mirrored: y")


PLACE = pose(600.0, 1600.0, 30.0, yaw=0.7)


@pytest.mark.parametrize(
    ("mistake", "place"), [(0, "mirrored: y"), (7, "yaw counted the other way")]
)
def test_mistakes_made_in_a_map(sound, mistake, place):
    undo = LABEL_MISTAKES[mistake].undo
    mapped = [replace(each, map_SE3_world=PLACE) for each in sound]
    assert diagnose_labels(mapped[:1]) == []
    wrong = with_boxes(mapped[:1], lambda b: move_boxes(invert(PLACE), undo(move_boxes(PLACE, b))))
    (finding,) = diagnose_labels(wrong)
    assert finding.suspected.startswith(place)


def test_mistakes_made_in_the_frames_of_sensors(sound):
    """Each of two lidars has labels of its own, with the mistake in its own frame."""
    poles = [pose(1.0, -2.0, 5.0, yaw=0.3), pose(-4.0, 7.0, 6.0, yaw=1.3)]
    (cloud,) = sound[0].clouds
    parts = np.array_split(cloud.points, 2)
    clouds = tuple(
        SensorCloud(str(k), part, pole, "world")
        for k, (part, pole) in enumerate(zip(parts, poles, strict=True))
    )
    boxes = [
        move_boxes(p, LABEL_MISTAKES[0].undo(move_boxes(invert(p), sound[0].objects.boxes)))
        for p in poles
    ]
    mixed = np.where(np.arange(14)[:, None] % 2 == 0, *boxes)
    assert diagnose_labels([sound[0].with_clouds(clouds)]) == []
    (finding,) = diagnose_labels(
        [replace(sound[0].with_clouds(clouds), objects=Objects(mixed, ids=np.arange(14)))]
    )
    assert finding.suspected == "mirrored: y points the other way"


BENCHES = Path(__file__).parents[2] / "benchmarks" / "toolkit"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


mistakes = load(BENCHES / "written_mistakes.py")
bench = load(BENCHES / "bench_doctor.py")
LABELLED = [name for name in LAYOUTS if mistakes.TERMS.get(name) and name != "hdf5"]
ALL = list(mistakes.MISTAKES)
# one of each layout, such that all are there
SOME = [(layout, ALL[k % len(ALL)]) for k, layout in enumerate(LABELLED)]


@pytest.fixture(scope="module")
def samples():
    """Cars that drive on flat ground, seen from a pole of two lidars in some place of a map."""
    pole = pose(1.0, -2.0, 0.5, yaw=0.3)
    put, made = [], recording(count=4, ground_points=1500)
    for sample in made:
        (cloud,) = sample.clouds
        points = transform(invert(pole), cloud.points).astype(np.float32)
        halves = zip(("106", "105"), np.array_split(points, 2), strict=True)
        clouds = tuple(SensorCloud(name, half, pole) for name, half in halves)
        put.append(
            replace(sample.with_clouds(clouds), time=1.7e9 + sample.time, map_SE3_world=bench.PLACE)
        )
    return put


@pytest.fixture(scope="module", autouse=True)
def ground_found_once():
    """Files of labels change here, clouds and their ground do not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box_fits, "level", bench.remembered(level))
        yield


@pytest.fixture(scope="module")
def written(samples, tmp_path_factory):
    """Folders of the layouts, each written once."""
    made = {}

    def of(layout):
        if layout not in made:
            made[layout] = tmp_path_factory.mktemp(layout)
            bench.write_layout(samples, made[layout], layout)
        return made[layout]

    return of


def said_of(path, layout):
    return [
        finding.suspected for finding in diagnose_labels(islice(open_recording(path, layout), 10))
    ]


def check(written, layout, mistake):
    path, terms = written(layout), mistakes.TERMS.get(layout)
    untouched = terms.read(path)
    try:
        mistakes.make(mistake, path, terms)
        said = said_of(path, layout)
    finally:
        terms.write(path, untouched)
    assert bench.verdict(mistake, said) == "found", said


@pytest.mark.one_in(4)
@pytest.mark.parametrize("layout", LABELLED)
def test_nothing_is_suspected_of_untouched_files(written, layout):
    path, terms = written(layout), mistakes.TERMS.get(layout)
    terms.write(path, terms.read(path))  # and the bench reads and writes what is there
    assert said_of(path, layout) == []


@pytest.mark.parametrize("layout", LABELLED)
def test_boxes_are_read_within_a_millimetre_and_a_hundredth_of_a_degree(samples, written, layout):
    """Also of the layout that only the bench writes, whose labels are each sensor's own."""
    for before, after in zip(samples, open_recording(written(layout), layout), strict=True):
        a, b = (
            move_boxes(sample.map_SE3_world, sample.objects.boxes) for sample in (before, after)
        )
        if np.allclose(after.map_SE3_world, np.eye(4)):  # a layout that has no place for a map
            a = before.objects.boxes
        order = [np.lexsort(boxes[:, :2].round(2).T) for boxes in (a, b)]
        a, b = a[order[0]], b[order[1]]
        np.testing.assert_allclose(a[:, :6], b[:, :6], atol=1e-3)
        assert np.rad2deg(np.abs(np.angle(np.exp(1j * (a[:, 6] - b[:, 6]))))).max() < 0.01


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("layout", "mistake"), SOME)
def test_mistakes_are_found(written, layout, mistake):
    check(written, layout, mistake)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ALL)
@pytest.mark.parametrize("layout", LABELLED)
def test_every_mistake_is_found_on_every_layout(written, layout, mistake):
    check(written, layout, mistake)


def test_verdicts_on_every_layout():
    only_read = {"rosbag", "foxglove", "kitti-tracking", "pcap"}
    assert set(LAYOUTS) - set(mistakes.TERMS) == only_read
    assert {mistake for _, mistake in SOME} == set(ALL)
    assert bench.verdict(None, []) == "nothing"
    assert bench.verdict("late", []) == "not found"
    assert bench.verdict("late", ["labels lie about 0.2 s behind the clouds"]) == "found"
    assert (
        bench.verdict("late", ["mirrored: y", "labels lie about"])
        == "mirrored: y; labels lie about"
    )


def test_what_cannot_be_is_named_with_its_number():
    def listed(times, **problems):
        return [
            Frame.of_clouds(str(k), (), Objects.empty(), time=t, problems=problems)
            for k, t in enumerate(times)
        ]

    empty = [
        *diagnosis.find_impossible(
            listed([0.0, 0.1], **{problem_kinds.EMPTY: 1, problem_kinds.FAR_POINTS: 9})
        )
    ]
    assert [each.evidence for each in empty if each.where == "clouds"] == [
        "2, in 2 frames",
        "18, in 2 frames",
    ]
    counted = {problem_kinds.STRAY: 2, problem_kinds.TOO_LARGE: 1, "doubled labels": 3}
    found = [*diagnosis.find_impossible(listed([0.0], **counted))]
    assert [each.suspected for each in found] == [problem_kinds.STRAY, problem_kinds.TOO_LARGE]
    assert found[0].evidence == "2, beside 0 labels that are read"
    for times, says in (
        *(
            ([3.0, 2.0, 1.0], "times that repeat or go back"),
            ([0.0, 1e5, 2e5], "times in another unit than seconds"),
        ),
        *(([0.0, 0.1, 0.2, 0.0, 0.1, 0.2], None), ([np.nan, np.nan], None)),
    ):
        assert [each.suspected for each in diagnosis.find_impossible(listed(times))] == [
            says
        ] * bool(says)
