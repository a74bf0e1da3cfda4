from dataclasses import replace

import numpy as np
import pytest

from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.samples.label_fits import Seen
from toolkit.detection.samples.label_mistakes import YAW_SIGN
from toolkit.detection.samples.label_times import against_their_way, movers_in, shift_of
from toolkit.geometry import pose
from toolkit.objects import Objects

SPEED = 10.0  # m/s
HEADINGS = np.array([0.0, 0.0, np.pi / 2, np.pi / 2, np.pi / 2, -np.pi / 2])


def driving(count=4, late=0, *, seconds=0.1, ids=True, place=None):
    """Cars that drive along the axes, fronts and backs seen; late: samples that their labels lag behind."""
    start = np.column_stack(
        [[-20, -15, 0, 5, 10, 15], np.zeros(6), np.full(6, 1.0), np.tile([4, 2, 1.6], (6, 1)), HEADINGS]
    )
    ahead = np.column_stack([np.cos(HEADINGS), np.sin(HEADINGS)])
    made = []
    for k in range(count):
        now, labelled = start.copy(), start.copy()
        now[:, :2] += SPEED * seconds * k * ahead
        labelled[:, :2] += SPEED * seconds * (k - late) * ahead
        aside = np.linspace(-0.9, 0.9, 30)
        faces = [np.column_stack([box[0] + end * np.cos(box[6]) - aside * np.sin(box[6]),
                                  box[1] + end * np.sin(box[6]) + aside * np.cos(box[6]),
                                  np.linspace(0.6, 1.6, 30)]) for box in now for end in (2.0, -2.0)]  # fmt: skip
        numbers = np.arange(6) if ids else np.arange(6) + 100 * k
        cloud = SensorCloud("s", np.concatenate(faces).astype(np.float32), np.eye(4))
        sample = Sample(str(k), (cloud,), Objects(labelled, ids=numbers), time=5 + seconds * k if ids else np.nan)
        made.append(sample if place is None else replace(sample, map_SE3_world=place))
    return made


def seen(samples):
    return [Seen(sample, sample.points()) for sample in samples]


def test_what_moves_and_how_fast():
    boxes, velocities, ids = movers_in(driving(), 1)
    assert ids.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(velocities, SPEED * np.column_stack([np.cos(HEADINGS), np.sin(HEADINGS)]), atol=1e-9)
    assert len(boxes) == 6
    assert len(movers_in(driving(ids=False), 1).boxes) == 0
    assert len(movers_in(driving(1), 0).boxes) == 0
    assert len(movers_in(driving(seconds=1e-6), 0).boxes) == 6
    still = [replace(each, time=time) for each, time in zip(driving(2), (0.0, 100.0), strict=True)]
    assert len(movers_in(still, 0).boxes) == 0


def test_velocities_are_of_the_map():
    """A vehicle that drives as fast as what it looks at: in its frame nothing moves, in the map everything does."""
    one, two = driving(2)
    moved = replace(two, objects=one.objects, map_SE3_world=pose(1.0, 0.0, 0.0))
    np.testing.assert_allclose(movers_in([one, moved], 0).velocities, np.tile([10.0, 0.0], (6, 1)), atol=1e-9)


@pytest.mark.parametrize(("late", "behind"), [(1, True), (-1, False), (2, True)])
def test_labels_of_another_time_along_their_tracks(late, behind):
    shift = shift_of(seen(driving(late=late)))
    assert shift is not None
    assert (shift.amount, shift.behind) == (f"{0.1 * abs(late):g} s", behind)
    assert shift.after.mean() == 1.0
    assert shift.before.mean() < 0.5


@pytest.mark.parametrize(
    ("late", "amount", "behind"), [(1, "1 sample", True), (-1, "1 sample", False), (2, "2 samples", True)]
)
@pytest.mark.parametrize("place", [None, pose(600.0, 1600.0, 0.0, yaw=0.7)])
def test_labels_of_another_time_without_times_and_tracks(late, amount, behind, place):
    shift = shift_of(seen(driving(6, late, ids=False, place=place)))
    assert shift is not None
    assert (shift.amount, shift.behind) == (amount, behind)


@pytest.mark.parametrize("ids", [True, False])
def test_nothing_is_said_of_labels_of_the_same_time(ids):
    assert shift_of(seen(driving(ids=ids))) is None
    assert shift_of(seen(driving(1, ids=ids))) is None
    assert shift_of([]) is None


def wrong(samples):
    return [replace(each, objects=Objects(YAW_SIGN.undo(each.objects.boxes), ids=each.objects.ids)) for each in samples]


def test_fronts_that_point_backwards_are_counted():
    def undo(sample, boxes):
        return YAW_SIGN.undo(boxes)

    headed = against_their_way(wrong(driving()), undo)
    assert headed == (4, 16, 24)
    assert against_their_way(driving(), undo) is None
    assert against_their_way(wrong(driving(ids=False)), undo) is None
    alone = [each.of(np.arange(3)) for each in wrong(driving(8))]
    assert against_their_way(alone, undo) is None  # one car that drives backwards is no mistake of all


def test_a_mistake_that_spoils_as_many_is_none():
    def turned(sample, boxes):
        return boxes + np.array([0, 0, 0, 0, 0, 0, np.pi])

    assert against_their_way(wrong(driving()), turned) is None
