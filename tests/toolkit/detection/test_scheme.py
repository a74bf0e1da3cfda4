"""What schemes send in expectation, and what comes of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.detection.codec import PAPER
from toolkit.detection.scheme import Fused, estimate_bits
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detections

COUNTS = SimpleNamespace(
    sent=np.full((2, 3), 10, np.float32),
    far=np.full((2, 3), 4, np.float32),
    on_objects=np.full((2, 3), 2, np.float32),
)


@pytest.mark.parametrize(
    ("name", "points", "boxes"), [("early", 30, 0), ("late", 0, 5), ("hybrid", 12, 5)]
)
def test_expected_bits(name, points, boxes):
    sent = estimate_bits(find_scheme(name), PAPER, COUNTS, np.full(2, 5.0))
    assert sent.tolist() == [96 * points + 256 * boxes] * 2


def test_own_codecs_and_means_per_sensor():
    """Three messages of 34 bytes and 5 bit for each of six pixels."""
    assert (
        estimate_bits(find_scheme("foreground"), PAPER, COUNTS, np.full(2, 5.0)).tolist()
        == [3 * 34 * 8 + 6 * 5] * 2
    )
    nothing = Detections.empty()
    assert Fused(nothing, np.array([1000, 3000])).kbit_per_sensor == 2
    assert Fused(nothing, np.zeros(0, np.int64)).kbit_per_sensor == 0
