"""Range images through the codec, for every model of sensor."""

import numpy as np
import pytest

from toolkit.detection.codec import Codec, ImageCodec, Message, RangeImage
from toolkit.detection.link.message import read_message, sensor_number
from toolkit.detection.link.range_images import STEPS, RangeImages, from_steps
from toolkit.objects import Detections
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sensors.spinning_lidar import SpinningLidar

MODELS = [
    DepthCamera(width=40, height=30, max_range=80.0),
    SpinningLidar(channels=12),
    SolidStateLidar(rows=9, columns=14),
]


def image(model, seed=0):
    """Smooth, noise, drop-outs, what is no return, the nearest and the farthest there is."""
    rng = np.random.default_rng(seed)
    measured = rng.uniform(0, 1.2 * model.max_range, model.shape).astype(np.float32)
    measured[::2] = 20 + np.arange(model.shape[1], dtype=np.float32) / 50
    measured[rng.random(model.shape) < 0.2] = 0
    measured.ravel()[:7] = [
        np.nan,
        np.inf,
        -3,
        1e-3,
        0.0099,
        np.nextafter(np.float32(model.max_range), 0),
        model.max_range,
    ]
    return RangeImage(Sensor("s", model, np.eye(4)), measured, 2.5, 11)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
def test_every_pixel_arrives_within_half_a_step(model, step):
    codec, sent = RangeImages(step), image(model)
    message = codec.encode_image(sent)
    got = codec.decode_image(message, sent.sensor)
    there = (sent.measurement > 0) & (sent.measurement < model.max_range)
    np.testing.assert_array_equal((got > 0) & (got < model.max_range), there)
    assert (got[~there] == 0).all()
    assert np.abs(got[there].astype(float) - sent.measurement[there]).max() <= step / 2 + 1e-5
    header, _ = read_message(message.content)
    assert (header.sensor, header.number, header.time, header.step) == (sensor_number("s"), 11, 2.5, step)
    assert message.bits == 8 * len(message.content)


def test_steps_below_half_of_one_are_still_a_return():
    mask = np.array([[True, True, True, False]])
    got = from_steps(np.array([[0, 1, 10**9, 5]]), mask, 0.08, DepthCamera(max_range=50.0))
    np.testing.assert_allclose(got, [[0.02, 0.08, 50.0, 0.0]])
    assert got[0, 2] < 50


def test_another_sensor_refuses_the_message():
    codec, sent = RangeImages(), image(MODELS[0])
    message = codec.encode_image(sent)
    for other in (Sensor("t", MODELS[0], np.eye(4)), Sensor("s", MODELS[2], np.eye(4))):
        with pytest.raises(ValueError, match="it is another's"):
            codec.decode_image(message, other)
    with pytest.raises(ValueError, match="of kind boxes, got range_image"):
        codec.decode_boxes(message)
    with pytest.raises(ValueError, match="checksum"):
        codec.decode_image(Message(message.content[:-1] + b"x", message.bits), sent.sensor)


def test_boxes_go_as_bytes():
    boxes = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5]])
    message = RangeImages().encode_boxes(Detections(boxes, np.array([0.5])))
    np.testing.assert_allclose(RangeImages().decode_boxes(message).boxes, boxes, atol=0.01)
    assert message.bits == 8 * len(message.content) < 100 * 8


def test_it_is_a_codec_of_images_and_refuses_points_alone():
    codec = RangeImages(0.04)
    assert isinstance(codec, Codec)
    assert isinstance(codec, ImageCodec)
    assert codec.digest == "RangeImages(step=0.04)"
    with pytest.raises(ValueError, match="got 3 points alone"):
        codec.encode_points(np.zeros((3, 3), np.float32))
    with pytest.raises(ValueError, match="sends images"):
        codec.decode_points(Message(b"", 0))
    with pytest.raises(ValueError, match="step must be"):
        RangeImages(0.0)
    assert codec.bits(points=np.array([0, 100]), boxes=2, messages=3).tolist() == [816 + 150, 816 + 650]
