"""The mean over IoU thresholds: of a set, of each class, of some frames."""

import numpy as np
import pytest

from placement_env.classes import Classes
from placement_env.fidelity.combined.mean_iou import (
    MeanByFrames,
    MeanFidelity,
    iou_range,
    iou_thresholds,
    mean_of,
)
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.surrogate import Surrogate
from placement_env.protocol import ByFrames

SETS = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1]], bool)


def test_the_mean_of_surrogates(seen, hit_models):
    each = [Surrogate(seen, "early", hit_models["early"]), Surrogate(seen, "early", iou=0.9)]
    found = mean_of(each)
    assert type(found) is MeanFidelity
    assert not isinstance(found, ByFrames)
    assert (found.name, found.classes) == ("surrogate", Classes())
    one, other = (fidelity(SETS) for fidelity in each)
    assert found(SETS).ap == pytest.approx((one.ap + other.ap) / 2)
    assert found(SETS).recall == pytest.approx((one.recall + other.recall) / 2)
    assert np.array_equal(found(SETS).kbit, one.kbit)
    assert found.by_class(SETS).ap[:, 0] == pytest.approx((one.ap + other.ap) / 2)
    assert mean_of(each[:1]) is each[0]


def test_the_mean_of_detection_is_of_frames_too(street):
    common = (street.detected.renders, street.detected.detector, "early")
    each = [Detected(*common, iou=iou) for iou in (0.5, 1.0)]
    found = mean_of(each)
    assert isinstance(found, MeanByFrames)
    assert found.frames == 8
    assert found.partial(SETS, [0, 3]).ap == pytest.approx(np.mean([e.partial(SETS, [0, 3]).ap for e in each], axis=0))


@pytest.mark.parametrize(
    ("text", "thresholds"),
    [("0.7", (0.7,)), ("0.5:0.95", (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)), ("0.8:0.8", (0.8,))],
)
def test_thresholds_as_the_command_line_says_them(text, thresholds):
    assert iou_range(text) == thresholds


@pytest.mark.parametrize("text", ["", "high", "1.5", "0", "0.9:0.5", "0.5:0.7:0.9", "0.5:", "nan"])
def test_what_is_no_threshold_is_refused(text):
    with pytest.raises(ValueError, match="--iou must lie above 0 and at most at 1"):
        iou_range(text)


def test_thresholds_of_python():
    assert iou_thresholds((0.9, 0.7)) == (0.7, 0.9)
    for wrong in ((), (0.7, 0.7), (0.7, 1.5)):
        with pytest.raises(ValueError, match=r"(?i)iou"):
            iou_thresholds(wrong)
