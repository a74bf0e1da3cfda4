"""Detectors by name, with `+background` behind it or not, and in clouds of any kind."""

import warnings
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import open3d as o3d
import pytest

import models
from coview.detector_spec import DetectorSpec
from coview.detectors import load_detector, open_detector
from models.detector import MIN_UNKNOWN_PERSON_SCORE
from toolkit.calibration.place import Place
from toolkit.clouds import from_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import Background, KnownBackground, site_background
from toolkit.detection.cluster import ClusterDetector
from toolkit.objects import UnionDetector, known_labels
from toolkit.sites.files import load_site


def open_named(name, at):
    return open_detector(DetectorSpec.from_name(name), at)


def test_a_background_at_a_site_is_its_scenery():
    site = load_site("tjunction")
    bare: Any = open_named("voxelnet", site)
    known = open_named("voxelnet+background", site)
    assert isinstance(known, KnownBackground)
    assert known.detector.digest == bare.digest  # type: ignore[attr-defined]
    assert known.background.digest == site_background(site).digest
    assert known_labels(known) == known_labels(bare)


def test_a_background_needs_a_site_or_a_recording():
    with pytest.raises(ValueError, match=r"general\+background must see the site empty first"):
        open_named("general+background", Place())
    assert open_named("general", Place(area=(-10.0, -10.0, 10.0, 10.0)))


def test_at_an_unknown_site_pedestrians_need_a_higher_score():
    small = Place(area=(-10.0, -10.0, 10.0, 10.0))
    unknown, bare = (
        cast(Any, open_named(name, small)) for name in ("general", "general-background")
    )
    by_label = dict(
        zip(bare.config.labels, zip(bare.thresholds, unknown.thresholds, strict=True), strict=True)
    )
    before, after = by_label.pop("pedestrian")
    assert before < after == MIN_UNKNOWN_PERSON_SCORE
    assert all(before == after for before, after in by_label.values())
    assert unknown.digest != bare.digest


def test_grids_and_numbers_are_asked_for_behind_the_name(bfloat16_library):
    site = load_site("tjunction")
    bare: Any = open_named("voxelnet", site)
    phased: Any = open_named("voxelnet+phases3+background", site)
    assert (phased.name, phased.detector.phases) == ("tjunction+phases3+background", 3)
    bfloat16_library("torch")
    quick: Any = open_named("voxelnet+bfloat16", site)
    assert (quick.name, quick.digest != bare.digest) == ("tjunction+bfloat16", True)
    bfloat16_library(None)
    again: Any = open_named("voxelnet+bfloat16", site)
    assert again.digest == bare.digest
    for number in (0, 17):
        with pytest.raises(ValueError, match=f"1 to 16 grids, got {number}"):
            open_named(f"general+phases{number}", site)


def test_cluster_knows_its_background_anyhow(monkeypatch):
    x, y = np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 3, 0.1))
    clusters = ClusterDetector(
        Background.learn(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    )
    at_site = SimpleNamespace(site=load_site("tjunction"))
    monkeypatch.setattr(ClusterDetector, "from_recording", staticmethod(lambda recording: clusters))
    assert open_named("cluster+background", at_site) is clusters
    assert open_named("cluster", at_site) is clusters
    for name in ("cluster", "cluster+background"):
        with pytest.raises(ValueError, match="learns from a recording"):
            open_named(name, load_site("tjunction"))


class TestCloudsOfAnyKind:
    """`coview.load_detector` takes what Open3D and numpy hold, and levels it or says that it did
    not."""

    AREA = (-40, -20, 40, 20)

    @pytest.fixture
    def street(self, recording):
        """A cloud of the T-junction's six sensors with its ground at z = 0."""
        return CoopDataset(recording)[0].points().astype(np.float32)

    def test_all_kinds_give_the_same_boxes(self, street):
        detect = load_detector("general", area=self.AREA)
        bare = models.load_detector("general", area=self.AREA)(street)
        assert len(bare) > 3
        four = np.column_stack([street, np.ones(len(street), np.float32)])
        legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(street.astype(np.float64)))
        tensors = o3d.t.geometry.PointCloud(o3d.core.Tensor(street))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for cloud in (street, four, legacy, tensors, from_points(street)):
                np.testing.assert_allclose(detect(cloud).boxes, bare.boxes, atol=1e-4)
        assert detect.digest == models.load_detector("general", area=self.AREA).digest
        assert len(detect(o3d.t.geometry.PointCloud())) == 0
        assert isinstance(detect, UnionDetector)
        (joined,) = detect.unions([street[::2], street[1::2]], np.ones((1, 2), np.bool_))
        assert abs(len(joined) - len(bare)) <= 1

    def test_a_cloud_that_stands_lower_is_levelled_or_the_warning_says_where_it_stands(
        self, street
    ):
        lower = street - np.float32([0, 0, 1.7])
        detect = load_detector("general", area=self.AREA)
        with pytest.warns(
            UserWarning,
            match=r"^not levelled: .*ground seems to lie at z = -1\.[67].*level=\"map\"",
        ):
            detect(lower)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            detect(lower)  # said once
            levelled = load_detector("general", area=self.AREA, level="plane")
            found, known = levelled(lower), detect(street)
        assert len(found) >= 0.8 * len(known)
        assert abs(np.median(found.boxes[:, 2]) - (np.median(known.boxes[:, 2]) - 1.7)) < 0.2
        assert levelled.digest != detect.digest
        halves = levelled.unions([lower[::2], lower[1::2]], np.ones((1, 2), np.bool_))
        assert len(halves[0]) >= 0.8 * len(known)

    def test_what_is_no_cloud_is_refused(self):
        detect = load_detector("general")
        for wrong in (np.zeros((3, 900)), np.zeros(3), [["a", "b", "c"]]):
            with pytest.raises(ValueError, match=r"points must have shape \(n, 3\)"):
                detect(wrong)
        with pytest.raises(ValueError, match='level must be "map", "plane" or None'):
            load_detector("general", level="flat")
