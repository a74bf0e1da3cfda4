"""A detector that is asked once for each cloud."""

import numpy as np
import pytest

from placement_env.report.stress.kept_detections import KeptDetections
from toolkit.objects import Detections
from toolkit.runtime.cache import Cache


class Counting:
    digest = "counting"
    labels: tuple[str, ...] | None = None

    def __init__(self, at=0.0):
        self.calls, self.at = 0, at

    def __call__(self, points):
        self.calls += 1
        box = np.array([[points[:, 0].sum() + self.at, 0, 1, 4, 2, 1.5, 0.25]])
        return Detections(box, np.array([0.75]), np.array([3]))


POINTS = np.array([[1, 2, 3], [4, 5, 6]], np.float32)


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("boxes", "scores", "labels"))


def test_the_same_points_are_asked_once():
    detector = Counting()
    kept = KeptDetections(detector)
    first, again = kept(POINTS), kept(POINTS.copy())
    assert same(first, again)
    assert same(first, Counting()(POINTS))
    assert (detector.calls, kept.asked) == (1, 1)
    for other in (
        POINTS[::-1],
        POINTS[:1],
        POINTS + np.float32(0.01),
        POINTS.reshape(-1)[:3].reshape(1, 3),
        POINTS[:0],
    ):
        kept(other)
    assert detector.calls == 5  # the first point alone comes twice


def test_on_disk_it_outlives_the_run_and_belongs_to_its_detector(tmp_path):
    first = KeptDetections(Counting(), Cache(tmp_path / "kept"))(POINTS)
    later = Counting(at=99.0)
    assert same(KeptDetections(later, Cache(tmp_path / "kept"))(POINTS), first)
    assert later.calls == 0
    other = Counting()
    other.digest = "another"
    KeptDetections(other, Cache(tmp_path / "kept"))(POINTS)
    assert other.calls == 1


def test_a_detector_that_says_nothing_of_itself_is_not_kept_on_disk(tmp_path):
    def detect(points):
        return Detections.empty()

    assert len(KeptDetections(detect)(POINTS)) == 0
    with pytest.raises(ValueError, match="needs an attribute digest"):
        KeptDetections(detect, Cache(tmp_path / "kept"))


def test_it_knows_what_its_detector_knows_and_is_not_wrapped_twice():
    detector = Counting()
    detector.labels = ("cyclist", "vehicle")
    kept = KeptDetections(detector)
    assert kept.labels == ("vehicle", "cyclist")
    assert KeptDetections(Counting()).labels is None
    assert KeptDetections.of(kept) is kept
    assert same(KeptDetections.of(detector)(POINTS), kept(POINTS))
