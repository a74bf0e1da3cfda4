"""Boxes as bytes and back, to 2 cm and half a degree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toolkit.detection.link.box_coding import decode_boxes, encode_boxes
from toolkit.objects import Detections


def some(n, seed=0):
    rng = np.random.default_rng(seed)
    boxes = np.column_stack([rng.uniform(-60, 60, (n, 2)), rng.uniform(-1, 3, n), rng.uniform(0.3, 12, (n, 3)),
                             rng.uniform(-7, 7, n)])  # fmt: skip
    return Detections(boxes, rng.random(n), rng.integers(0, 4, n))


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 40), st.integers(0, 1000))
def test_boxes_come_back_to_a_centimetre_and_a_quarter_of_a_degree(n, seed):
    sent = some(n, seed)
    got = decode_boxes(encode_boxes(sent))
    assert len(got) == n
    assert np.abs(got.boxes[:, :6] - sent.boxes[:, :6]).max(initial=0) <= 0.01 + 1e-9
    turn = (got.boxes[:, 6] - sent.boxes[:, 6] + np.pi) % (2 * np.pi) - np.pi
    assert np.rad2deg(np.abs(turn)).max(initial=0) <= 0.25 + 1e-9
    assert np.abs(got.scores - sent.scores).max(initial=0) <= 0.5 / 255 + 1e-9
    assert got.labels.tolist() == sent.labels.tolist()


def test_what_arrives_is_sent_again_unchanged():
    once = decode_boxes(encode_boxes(some(20)))
    assert encode_boxes(once) == encode_boxes(decode_boxes(encode_boxes(once)))


def test_a_box_takes_a_third_of_the_papers_256_bits():
    assert 8 * len(encode_boxes(some(100))) < 100 * 90
    assert encode_boxes(Detections.empty()) == b"\x00\x00"


def test_scores_beyond_0_and_1_are_cut_and_yaw_is_wrapped():
    boxes = np.array([[0, 0, 0, 4, 2, 1, np.deg2rad(359.0)], [0, 0, 0, 4, 2, 1, np.deg2rad(-180)]])
    got = decode_boxes(encode_boxes(Detections(boxes, np.array([1.5, -0.2]))))
    assert got.scores.tolist() == [1.0, 0.0]
    np.testing.assert_allclose(np.rad2deg(got.boxes[:, 6]), [-1, -180])


def test_sure_scores_stay_apart():
    sure = Detections(some(4).boxes, np.array([0.9985, 0.9988, 0.9992, 0.9998]))
    scores = decode_boxes(encode_boxes(sure)).scores
    assert np.abs(scores - sure.scores).max() < 1e-4
    assert (np.diff(scores) > 0).all()


def test_boxes_that_cannot_be_sent_are_refused():
    for value, said in ((np.nan, "finite"), (np.inf, "finite"), (1e9, "within 21475 km")):
        boxes = np.array([[value, 0, 0, 4, 2, 1, 0.0]])
        with pytest.raises(ValueError, match=said):
            encode_boxes(Detections(boxes, np.array([0.5])))


def test_what_no_encoder_writes_is_refused():
    content = encode_boxes(some(3))
    for length in range(len(content)):
        with pytest.raises(ValueError, match=r"cut off|fit"):
            decode_boxes(content[:length])
    with pytest.raises(ValueError, match="followed by 1 bytes"):
        decode_boxes(content + b"x")
    with pytest.raises(ValueError, match="followed by 1 bytes"):
        decode_boxes(b"\x00\x00x")
    wide = bytearray(content)
    wide[2] = 32
    with pytest.raises(ValueError, match="up to 31 bits, got 32"):
        decode_boxes(bytes(wide))
    score = bytearray(encode_boxes(Detections(some(1).boxes, np.array([0.0]))))
    score[2 + 7 * 5 + 1 : 2 + 7 * 5 + 3] = b"\x00\x02"
    with pytest.raises(ValueError, match="0 to 511, got 512"):
        decode_boxes(bytes(score))
