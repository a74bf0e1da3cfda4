"""Detectors by name, with `+background` behind it or not."""

from types import SimpleNamespace

import numpy as np
import pytest

from coview.detectors import place_detector, recording_detector, site_detector, split_background
from toolkit.detection.background import Background, KnownBackground, site_background
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.place import Place
from toolkit.objects import known_labels
from toolkit.sites.files import load_site


def test_backgrounds_are_known_by_name_and_of_the_scenery():
    assert split_background("general") == ("general", False)
    assert split_background("my.package:detect+background") == ("my.package:detect", True)
    assert split_background("background") == ("background", False)
    site = load_site("tjunction")
    bare, known = site_detector("voxelnet", site), site_detector("voxelnet+background", site)
    assert isinstance(known, KnownBackground)
    assert known.detector.digest == bare.digest  # type: ignore[attr-defined]
    assert known.background.digest == site_background(site).digest
    assert known_labels(known) == known_labels(bare)
    with pytest.raises(ValueError, match=r"general\+background must see the site empty first"):
        place_detector("general+background", Place())
    assert place_detector("general", Place(area=(-10.0, -10.0, 10.0, 10.0)))


def test_cluster_knows_its_background_anyhow(monkeypatch):
    x, y = np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 3, 0.1))
    clusters = ClusterDetector(Background.learn(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])))
    at_site = SimpleNamespace(site=load_site("tjunction"))
    monkeypatch.setattr(ClusterDetector, "of", staticmethod(lambda recording: clusters))
    assert recording_detector("cluster+background", at_site) is clusters
    assert recording_detector("cluster", at_site) is clusters
    for name in ("cluster", "cluster+background"):
        with pytest.raises(ValueError, match="learns from a recording"):
            site_detector(name, load_site("tjunction"))
