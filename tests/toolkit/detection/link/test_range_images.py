"""Boxes as bytes and back, to 2 cm and half a degree."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.detection.codec import PAPER, Codec, ImageCodec, check_codec
from toolkit.detection.link import range_images
from toolkit.detection.link.message import read_message, sensor_number, write_message
from toolkit.detection.messages import Message, Origin, RangeImage
from toolkit.geometry import pose
from toolkit.objects import Detections
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

POLE = Sensor("p", DepthCamera(), np.eye(4))


def encode_boxes(detections):
    return range_images.encode_boxes(detections, POLE)


def decode_boxes(content):
    return range_images.decode_boxes(content, POLE)


def some(n, seed=0):
    rng = np.random.default_rng(seed)
    boxes = np.column_stack(
        [
            rng.uniform(-60, 60, (n, 2)),
            rng.uniform(-1, 3, n),
            rng.uniform(0.3, 12, (n, 3)),
            rng.uniform(-7, 7, n),
        ]
    )
    return Detections(boxes, rng.random(n), rng.integers(0, 4, n))


@settings(deadline=None, max_examples=15)
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


def test_scores_bound_boxes_and_encoders_bound_images():
    once = decode_boxes(encode_boxes(some(20)))
    assert encode_boxes(once) == encode_boxes(decode_boxes(encode_boxes(once)))
    assert 8 * len(encode_boxes(some(100))) < 100 * 90
    assert encode_boxes(Detections.empty()) == b"\x00\x00"
    assert len(encode_boxes(some(1))) == 2 + 9 * 5  # one box needs no bits beside its least numbers
    boxes = np.array([[0, 0, 0, 4, 2, 1, np.deg2rad(359.0)], [0, 0, 0, 4, 2, 1, np.deg2rad(-180)]])
    got = decode_boxes(encode_boxes(Detections(boxes, np.array([1.5, -0.2]))))
    assert got.scores.tolist() == [1.0, 0.0]
    np.testing.assert_allclose(np.rad2deg(got.boxes[:, 6]), [-1, -180])
    sure = Detections(some(4).boxes, np.array([0.9985, 0.9988, 0.9992, 0.9998]))
    scores = decode_boxes(encode_boxes(sure)).scores
    assert np.abs(scores - sure.scores).max() < 1e-4
    assert (np.diff(scores) > 0).all()
    most = Detections(
        np.array([[2000.0, 0, 0, 4, 2, 1, 0.0]] * range_images.MAX_BOXES), np.full(1000, 0.5)
    )
    np.testing.assert_allclose(decode_boxes(encode_boxes(most)).boxes, most.boxes)
    more = Detections(
        np.repeat(most.boxes[:1], range_images.MAX_BOXES + 1, axis=0), np.full(1001, 0.5)
    )
    with pytest.raises(ValueError, match="a message holds at most 1000 boxes, got 1001"):
        encode_boxes(more)
    alike, partly = (
        most.boxes[[0, 0]],
        np.array([[9.0, 0, 0, 4, 2, 1, 0.0], [9.0, 5, 0, 4, 2, 1, 0.0]]),
    )
    widths = [encode_boxes(Detections(each, np.full(2, 0.5)))[2] for each in (alike, partly)]
    assert widths == [
        1,
        0,
    ]  # bits of x: without any, as many boxes as one likes would take no bytes
    for value, said in (
        (np.nan, "finite"),
        (np.inf, "finite"),
        (1e9, "within 21475 km"),
        ((1 << 30) * 0.02, "within 21475 km"),
        (((1 << 30) - 1) * 0.02, "2000 m of sensor 'p'"),
        (2001.0, "2000 m of sensor 'p'"),
    ):
        boxes = np.array([[value, 0, 0, 4, 2, 1, 0.0]])
        with pytest.raises(ValueError, match=said):
            encode_boxes(Detections(boxes, np.array([0.5])))
    content = encode_boxes(some(3))
    for length in range(len(content)):
        with pytest.raises(ValueError, match=r"cut off|fit"):
            decode_boxes(content[:length])
    with pytest.raises(ValueError, match="got 1 more bytes"):
        decode_boxes(content + b"x")
    with pytest.raises(ValueError, match="got 1 more bytes"):
        decode_boxes(b"\x00\x00x")
    wide = bytearray(encode_boxes(Detections(some(1).boxes[[0, 0]], np.full(2, 0.5))))
    wide[2] = 31
    assert len(decode_boxes(bytes(wide[:-1]) + bytes(8))) == 2
    wide[2] = 32
    with pytest.raises(ValueError, match="up to 31 bits, got 32"):
        decode_boxes(bytes(wide))
    score = bytearray(encode_boxes(Detections(some(1).boxes, np.array([0.0]))))
    score[2 + 7 * 5 + 1 : 2 + 7 * 5 + 3] = b"\x00\x02"
    with pytest.raises(ValueError, match="0 to 511, got 512"):
        decode_boxes(bytes(score))


@pytest.mark.parametrize(
    ("x", "length", "said"),
    [
        *(
            (2000.0, 100.0, None),
            (2000.02, 0.3, "got 2000 m away and 0 m"),
            (0.3, 100.02, "got 0 m away and 100 m"),
        ),
        *((0.3, 150.0, "got 0 m away and 150 m"), (-2500.0, 0.3, "got 2500 m away and 0 m")),
    ],
)
def test_boxes_are_sent_up_to_just_how_far_and_how_long_they_may_be(x, length, said):
    small = Detections(np.array([[x, 0.2, 0.1, length, 0.2, 0.1, 0.0]]), np.array([0.5]))
    if said is None:
        np.testing.assert_allclose(decode_boxes(encode_boxes(small)).boxes, small.boxes, atol=1e-9)
    else:
        with pytest.raises(ValueError, match=said):
            encode_boxes(small)


def test_a_box_thinner_than_a_step_is_sent_a_step_thick():
    thin = Detections(np.array([[1.0, 2.0, 3.0, 0.004, 0.004, 0.004, 0.0]]), np.array([0.5]))
    assert decode_boxes(encode_boxes(thin)).boxes[0, 3:6] == pytest.approx([0.02] * 3)


MODELS = [
    *(DepthCamera(width=40, height=30, max_range=80.0), SpinningLidar(channels=12)),
    SolidStateLidar(rows=9, columns=14),
]


def image(model, seed=0):
    """Smooth, noise, drop-outs, what is no return, the nearest and the farthest there is."""
    rng = np.random.default_rng(seed)
    measured = rng.uniform(0, 1.2 * model.max_range, model.shape).astype(np.float32)
    measured[::2] = 20 + np.arange(model.shape[1], dtype=np.float32) / 50
    measured[rng.random(model.shape) < 0.2] = 0
    measured.ravel()[:7] = [
        *(
            np.nan,
            np.inf,
            -3,
            1e-3,
            0.0099,
            np.nextafter(np.float32(model.max_range), 0),
            model.max_range,
        )
    ]
    return RangeImage(Sensor("s", model, np.eye(4)), measured, 2.5, 11)


@pytest.mark.parametrize("step", range_images.STEPS_M)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
def test_every_pixel_arrives_within_half_a_step(model, step):
    codec, sent = range_images.RangeImages(step), image(model)
    message = codec.encode_image(sent)
    got = codec.decode_image(message, sent.sensor)
    there = (sent.measurement > 0) & (sent.measurement < model.max_range)
    np.testing.assert_array_equal((got > 0) & (got < model.max_range), there)
    assert (got[~there] == 0).all()
    assert np.abs(got[there].astype(float) - sent.measurement[there]).max() <= step / 2 + 1e-5
    header, _ = read_message(message.content)
    assert (header.sensor, header.number, header.time, header.step) == (
        sensor_number("s"),
        11,
        2.5,
        step,
    )
    assert message.bits == 8 * len(message.content)


def test_steps_become_measurements_in_range():
    mask = np.array([[True, True, True, False]])
    got = range_images.from_steps(
        np.array([[0, 1, 10**9, 5]]), mask, 0.08, DepthCamera(max_range=50.0)
    )
    np.testing.assert_allclose(got, [[0.02, 0.08, 50.0, 0.0]])
    assert got[0, 2] < 50
    near = range_images.from_steps(
        np.array([[10**9]]), np.ones((1, 1), bool), 0.08, DepthCamera(max_range=0.5)
    )
    assert near[0, 0] == np.nextafter(np.float32(0.5), np.float32(0))


def test_boxes_come_with_their_sensor_and_time():
    codec, sent = range_images.RangeImages(), image(MODELS[0])
    message = codec.encode_image(sent)
    for other in (Sensor("t", MODELS[0], np.eye(4)), Sensor("s", MODELS[2], np.eye(4))):
        with pytest.raises(ValueError, match="it belongs to another"):
            codec.decode_image(message, other)
    with pytest.raises(ValueError, match="of kind boxes, got range_image"):
        codec.decode_boxes(message, sent.sensor)
    with pytest.raises(ValueError, match="checksum"):
        codec.decode_image(Message(message.content[:-1] + b"x", message.bits), sent.sensor)
    boxes = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5]])
    message = codec.encode_boxes(Detections(boxes, np.array([0.5])), Origin(POLE, 2.5, 11))
    np.testing.assert_allclose(codec.decode_boxes(message, POLE).boxes, boxes, atol=0.01)
    header, _ = read_message(message.content)
    assert (header.sensor, header.number, header.time) == (sensor_number("p"), 11, 2.5)
    with pytest.raises(ValueError, match="it belongs to another"):
        codec.decode_boxes(message, sent.sensor)
    assert message.bits == 8 * len(message.content) < 100 * 8


def test_codecs_go_by_name():
    assert range_images.find_codec("paper") is PAPER
    assert range_images.find_codec("range-images") == range_images.RangeImages(0.02)
    assert range_images.find_codec("range-images", step=0.08) == range_images.RangeImages(0.08)
    assert all(check_codec(range_images.find_codec(name)) for name in range_images.CODECS)
    with pytest.raises(ValueError, match="choose among paper, range-images"):
        range_images.find_codec("zip")
    with pytest.raises(ValueError, match="step must be"):
        range_images.find_codec("range-images", step=0.0)


def test_codecs_of_images_refuse_points_without_images():
    codec = range_images.RangeImages(0.04)
    assert isinstance(codec, Codec)
    assert isinstance(codec, ImageCodec)
    assert codec.digest == "RangeImages(step=0.04)"
    with pytest.raises(ValueError, match="got 3 points alone"):
        codec.encode_points(np.zeros((3, 3), np.float32))
    with pytest.raises(ValueError, match="sends images"):
        codec.decode_points(Message(b"", 0))
    with pytest.raises(ValueError, match="step must be"):
        range_images.RangeImages(0.0)
    assert codec.bits(boxes=1) == codec.bits(boxes=1, messages=1) == 272 + 75
    assert np.array([codec.bits(points=1), codec.bits(), codec.bits(messages=0)]).tolist() == [
        272 + 5,
        272,
        0,
    ]
    assert codec.bits(points=np.array([0, 100]), boxes=2, messages=3).tolist() == [
        816 + 150,
        816 + 650,
    ]


def test_boxes_are_as_far_from_their_sensor_wherever_it_stands():
    far = Sensor("f", DepthCamera(), pose(500.0, 0.0, 0.0))
    for x, fits in ((2499.0, True), (-1499.0, True), (-1501.0, False), (2501.0, False)):
        box = Detections(np.array([[x, 0, 0, 4, 2, 1, 0.0]]), np.array([0.5]))
        if fits:
            assert range_images.decode_boxes(range_images.encode_boxes(box, far), far).boxes[
                0, 0
            ] == pytest.approx(x)
        else:
            with pytest.raises(ValueError, match="2001 m away"):
                range_images.encode_boxes(box, far)


def test_messages_of_boxes_have_no_image_and_no_scene():
    codec, sent = (
        range_images.RangeImages(),
        Detections(np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5]]), np.array([0.5])),
    )
    header, content = read_message(codec.encode_boxes(sent, Origin(POLE, 2.5, 11)).content)
    assert (header.rows, header.columns, header.scene, header.step_mm) == (0, 0, 0, 20)
    for name in ("rows", "columns", "scene", "step_mm"):
        other = write_message(replace(header, **{name: 7}), content)
        with pytest.raises(ValueError, match=f"whose {name} is (0|20), got 7"):
            codec.decode_boxes(Message(other, 0), POLE)


def test_whole_steps_are_those_of_what_is_sent():
    measured, sent = np.array([[1.0, 0.09, 3.0]], np.float32), np.array([[True, True, False]])
    assert range_images.to_steps(measured, sent, 0.04).tolist() == [[25, 2, 0]]
