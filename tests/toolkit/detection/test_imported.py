"""Detectors by the name Python knows them under."""

import pickle
import sys

import numpy as np
import pytest

from toolkit.detection.detect import ImportedDetector
from toolkit.objects import Detections
from toolkit.sites.files import load_site

MODULE = """
from toolkit.objects import Detections

def detect(points):
    return Detections.empty()

detect.digest = "1"

def of_area(area):
    xmin, ymin, xmax, ymax = area
    return lambda points: Detections.empty()

class Bare:
    def __call__(self, points):
        return Detections.empty()

def changing(points):
    return Detections.empty() if not len(points) else None

def breaking(points):
    return Detections.empty() if not len(points) else points[99]
"""


@pytest.fixture
def site(tmp_path, work_in):
    (tmp_path / "their_module.py").write_text(MODULE)
    work_in(tmp_path)
    yield load_site("tjunction")
    sys.modules.pop("their_module", None)


@pytest.mark.parametrize(
    ("name", "has_digest"), [("detect", True), ("of_area", False), ("Bare", False)]
)
def test_what_a_name_may_mean(name, has_digest, site):
    detector = ImportedDetector(f"their_module:{name}", site)
    assert isinstance(detector(np.zeros((3, 3), np.float32)), Detections)
    assert hasattr(detector, "digest") == has_digest
    assert isinstance(pickle.loads(pickle.dumps(detector)), ImportedDetector)


def test_what_it_returns_and_where_it_fails_is_said(site):
    detector = ImportedDetector("their_module:changing", site)
    with pytest.raises(ValueError, match=r"must return .* got NoneType"):
        detector(np.zeros((3, 3), np.float32))
    detector = ImportedDetector("their_module:breaking", site)
    with pytest.raises(
        ValueError, match=r"their_module:breaking fails with a cloud of 3 points \(IndexError"
    ):
        detector(np.zeros((3, 3), np.float32))
