"""Detectors by name, with `+background` behind it or not."""

import numpy as np
import pytest

from coview.detectors import of_background, recording_detector, sample_detector, site_detector
from toolkit.detection.background import Background, KnownBackground
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.site_background import site_background
from toolkit.objects import Detections, known_labels
from toolkit.sites.files import load_site


def nobody(points):
    return Detections.empty()


OWN = f"{__name__}:nobody"


def test_the_name_says_whether_the_background_is_known():
    assert of_background("general") == ("general", False)
    assert of_background("my.package:detect+background") == ("my.package:detect", True)
    assert of_background("background") == ("background", False)


def test_at_a_site_it_is_of_the_scenery():
    site = load_site("tjunction")
    bare, known = site_detector("voxelnet", site), site_detector("voxelnet+background", site)
    assert isinstance(known, KnownBackground)
    assert known.detector.digest == bare.digest  # type: ignore[attr-defined]
    assert known.background.digest == site_background(site).digest
    assert known_labels(known) == known_labels(bare)


def test_cluster_knows_its_background_anyhow(monkeypatch):
    x, y = np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 3, 0.1))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    clusters = ClusterDetector(Background.learn(ground))
    monkeypatch.setattr(ClusterDetector, "of", staticmethod(lambda recording: clusters))
    assert recording_detector("cluster+background", None) is clusters
    assert recording_detector("cluster", None) is clusters
    for name in ("cluster", "cluster+background"):
        with pytest.raises(ValueError, match="learns from a recording"):
            site_detector(name, load_site("tjunction"))


def test_clouds_alone_show_no_empty_site():
    with pytest.raises(ValueError, match=r"general\+background must see the site empty first"):
        sample_detector("general+background", None)
    assert sample_detector("general", (-10.0, -10.0, 10.0, 10.0))[1] == (0.0, 0.0)
