import math

import numpy as np
import pytest

from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.paper_codec import PaperCodec
from toolkit.objects import Detections

BOXES = np.array([[0.0, 0, 1, 4, 2, 1.5, 0], [9, 0, 1, 4, 2, 1.5, 0]])


def test_the_paper_counts_bits_of_points_and_boxes():
    points, boxes = np.ones((5, 3), np.float32), Detections(BOXES, np.array([0.5, 0.4]))
    assert PAPER.encode_points(points).bits == 5 * 3 * 32
    assert PAPER.encode_boxes(boxes).bits == 2 * 8 * 32
    assert PAPER.bits(points=5, boxes=2) == 5 * 96 + 2 * 256
    assert PAPER.bits(points=np.array([1.5, 0]), messages=3).tolist() == [144, 0]
    assert isinstance(PAPER, Codec)


def test_the_papers_codec_loses_nothing():
    points, boxes = (
        np.ones((5, 3), np.float32),
        Detections(BOXES, np.array([0.5, 0.4]), np.array([3, 1])),
    )
    assert PAPER.decode_points(PAPER.encode_points(points)) is points
    assert PAPER.decode_boxes(PAPER.encode_boxes(boxes)) is boxes
    codec = PaperCodec(bits_per_point=12.5, bits_per_box=40)
    for n in (0, 1, 10):
        assert codec.encode_points(np.zeros((n, 3), np.float32)).bits == round(
            float(codec.bits(points=n))
        )


def test_codecs_have_a_digest_and_all_members():
    assert PaperCodec().digest == PAPER.digest != PaperCodec(48).digest
    assert check_codec(PAPER) is PAPER
    with pytest.raises((ValueError, TypeError), match="codec"):
        check_codec("paper")
    with pytest.raises((ValueError, TypeError), match="codec"):
        check_codec(PaperCodec)


@pytest.mark.parametrize("bits", [-5, -0.1, math.nan, math.inf, True, None, "96"])
@pytest.mark.parametrize("which", ["bits_per_point", "bits_per_box"])
def test_nonsense_costs_are_refused(which, bits):
    with pytest.raises((ValueError, TypeError), match=which):
        PaperCodec(**{which: bits})
