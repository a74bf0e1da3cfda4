from dataclasses import replace

import numpy as np
import pytest

from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.samples.diagnosis import diagnose_samples
from toolkit.detection.samples.label_mistakes import LABEL_MISTAKES, boxes_through
from toolkit.geometry import invert, pose
from toolkit.objects import Objects

SPEED = 8.0  # m/s


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
    turned = np.column_stack([ahead * np.cos(yaw) - aside * np.sin(yaw), ahead * np.sin(yaw) + aside * np.cos(yaw)])
    return np.column_stack([turned + np.array([x, y]), up])


def recording(count=2, seconds=0.1, late=0.0, *, ground_points=8000, yaws=None):
    """Cars that drive along their headings on flat ground; late: by how much their labels lag behind (s)."""
    rng = np.random.default_rng(1)
    angle, away = np.linspace(0, 2 * np.pi, 14, endpoint=False), rng.uniform(8, 30, 14)
    start = np.column_stack(
        [away * np.cos(angle), away * np.sin(angle) + 2, np.full(14, 0.8), rng.uniform(3.8, 5, 14),
         rng.uniform(1.7, 2, 14), np.full(14, 1.6), rng.uniform(-3, 3, 14)]
    )  # fmt: skip
    start[:, 6] = start[:, 6] if yaws is None else yaws
    velocity = SPEED * np.column_stack([np.cos(start[:, 6]), np.sin(start[:, 6])])
    made = []
    for k in range(count):
        now, labelled = start.copy(), start.copy()
        now[:, :2] += velocity * seconds * k
        labelled[:, :2] += velocity * (seconds * k - late)
        ground = np.column_stack([rng.uniform(-45, 45, (ground_points, 2)), rng.normal(0, 0.01, ground_points)])
        points = np.concatenate([ground, *(hull(box, rng) for box in now)]).astype(np.float32)
        objects = Objects(labelled, ids=np.arange(14))
        made.append(Sample(str(k), (SensorCloud("s", points, np.eye(4)),), objects, time=100 + seconds * k))
    return made


def with_boxes(samples, change):
    """The samples with other boxes, as a reader that made the mistake would give them."""
    return [
        replace(each, objects=Objects(change(each.objects.boxes), each.objects.labels, each.objects.ids))
        for each in samples
    ]


@pytest.fixture(scope="module")
def sound():
    return recording()


MISTAKES = {
    "mirrored: y": lambda b: b * [1, -1, 1, 1, 1, 1, -1],
    "mirrored: x": lambda b: np.column_stack([-b[:, 0], b[:, 1:6], np.pi - b[:, 6]]),
    "x and y swapped": lambda b: np.column_stack([b[:, 1], b[:, 0], b[:, 2:6], np.pi / 2 - b[:, 6]]),
    "half extents": lambda b: b * [1, 1, 1, 0.5, 0.5, 0.5, 1],
    "doubled extents": lambda b: b * [1, 1, 1, 2, 2, 2, 1],
    "the centre of the floor": lambda b: np.column_stack([b[:, :2], b[:, 2] - b[:, 5] / 2, b[:, 3:]]),
    "the centre of the roof": lambda b: np.column_stack([b[:, :2], b[:, 2] + b[:, 5] / 2, b[:, 3:]]),
    "length and width swapped": lambda b: b[:, [0, 1, 2, 4, 3, 5, 6]],
    "yaw counted the other way": lambda b: b * [1, 1, 1, 1, 1, 1, -1],
    "yaw in radians where degrees": lambda b: np.column_stack([b[:, :6], np.deg2rad(b[:, 6])]),
}


def test_nothing_is_suspected_of_sound_labels(sound):
    assert diagnose_samples(sound) == []


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_classic_mistake_is_named_alone(sound, mistake):
    (finding,) = diagnose_samples(with_boxes(sound[:1], MISTAKES[mistake]))
    assert finding.suspected.startswith(mistake)
    assert finding.severity == "error"


@pytest.mark.parametrize(("late", "says"), [(0.2, "behind"), (-0.2, "ahead of")])
def test_labels_of_another_time(late, says):
    (finding,) = diagnose_samples(recording(late=late))
    assert finding.suspected == f"labels lie about 0.2 s {says} the clouds"


def test_degrees_read_as_radians_are_in_the_numbers(sound):
    far = [replace(sound[0], problems={"yaws beyond a full turn": 12})]
    (finding,) = diagnose_samples(far)
    assert finding.suspected == "yaw in degrees where radians belong"
    assert "12 of 14 yaws" in finding.evidence
    assert diagnose_samples([replace(sound[0], problems={"yaws beyond a full turn": 2})]) == []


def test_degrees_of_which_only_sine_and_cosine_are_left(sound):
    lost = with_boxes(sound, lambda b: np.column_stack([b[:, :6], np.angle(np.exp(1j * np.rad2deg(b[:, 6])))]))
    (finding,) = diagnose_samples(lost)
    assert finding.suspected == "yaw in degrees where radians belong, of which only sine and cosine are left"
    assert finding.remedy == "multiply yaw by pi / 180 before its sine and cosine are taken"


def test_along_the_axes_the_sign_of_yaw_is_seen_by_what_moves():
    along = recording(yaws=np.tile([np.pi / 2, -np.pi / 2], 7))
    assert diagnose_samples(along) == []
    (finding,) = diagnose_samples(with_boxes(along, MISTAKES["yaw counted the other way"]))
    assert finding.suspected == "yaw counted the other way round"
    assert finding.evidence == (
        "28 of 28 boxes that move, of 14 objects, head against their way, and along it with that undone"
    )


PLACE = pose(600.0, 1600.0, 30.0, yaw=0.7)


@pytest.mark.parametrize(("mistake", "place"), [(0, "mirrored: y"), (7, "yaw counted the other way")])
def test_mistakes_made_in_a_map(sound, mistake, place):
    undo = LABEL_MISTAKES[mistake].undo
    mapped = [replace(each, map_SE3_world=PLACE) for each in sound]
    assert diagnose_samples(mapped[:1]) == []
    wrong = with_boxes(mapped[:1], lambda b: boxes_through(undo(boxes_through(b, PLACE)), invert(PLACE)))
    (finding,) = diagnose_samples(wrong)
    assert finding.suspected.startswith(place)


def test_mistakes_made_in_the_frames_of_sensors(sound):
    """Each of two lidars has labels of its own, with the mistake in its own frame."""
    poles = [pose(1.0, -2.0, 5.0, yaw=0.3), pose(-4.0, 7.0, 6.0, yaw=1.3)]
    (cloud,) = sound[0].clouds
    parts = np.array_split(cloud.points, 2)
    clouds = tuple(
        SensorCloud(str(k), part, pole, "world") for k, (part, pole) in enumerate(zip(parts, poles, strict=True))
    )
    boxes = [boxes_through(LABEL_MISTAKES[0].undo(boxes_through(sound[0].objects.boxes, invert(p))), p) for p in poles]
    mixed = np.where(np.arange(14)[:, None] % 2 == 0, *boxes)
    assert diagnose_samples([replace(sound[0], clouds=clouds)]) == []
    (finding,) = diagnose_samples([replace(sound[0], clouds=clouds, objects=Objects(mixed, ids=np.arange(14)))])
    assert finding.suspected == "mirrored: y points the other way"


def test_heights_are_those_where_the_boxes_belong():
    """On a slope, mirrored boxes lie elsewhere, above or below the ground there."""
    (flat,) = recording(count=1)
    cloud = flat.clouds[0].points + np.float32(0)
    cloud[:, 2] += 0.1 * cloud[:, 1]
    boxes = flat.objects.boxes + np.column_stack([np.zeros((14, 2)), 0.1 * flat.objects.boxes[:, 1], np.zeros((14, 4))])
    sloped = replace(flat, clouds=(replace(flat.clouds[0], points=cloud),), objects=Objects(boxes))
    assert diagnose_samples([sloped]) == []
    (finding,) = diagnose_samples(with_boxes([sloped], MISTAKES["mirrored: y"]))
    assert finding.suspected.startswith("mirrored: y")


def test_too_little_to_say_anything():
    assert diagnose_samples([]) == []
    nothing = Sample("0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty())
    assert diagnose_samples([nothing]) == []
