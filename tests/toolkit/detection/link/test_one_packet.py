"""Foreground messages that fit one packet, and the codec that other programs call."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.toolkit.detection.link import page_reader
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.codec import PAPER
from toolkit.detection.link.foreground import (
    Foreground,
    decode_foreground,
    encode_foreground,
    encode_in_packet,
    list_steps,
)
from toolkit.detection.link.message import read_message
from toolkit.detection.link.packets import count_packets, find_airtime_us
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.link.sensor_codec import SensorCodec
from toolkit.detection.messages import RangeImage
from toolkit.detection.scheme import estimate_bits
from toolkit.exchange.geonetworking import PACKET_BYTES
from toolkit.frame import Frame, SensorCloud, unproject
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSOR = Sensor("s", DepthCamera(width=160, height=120), look((0.0, 0.0, 6.0), 0.0, 0.4))
SHAPE = SENSOR.model.shape
SCENE = EmptyScene.from_render(SENSOR, np.full(SHAPE, 60, np.float32))
AREA = (-100.0, -100.0, 100.0, 100.0)


def rough(pixels, seed=0):
    """Image with `pixels` pixels of a surface that is rough by half a metre, in a block."""
    image = np.zeros(SHAPE, np.float32)
    rng = np.random.default_rng(seed)
    image.ravel()[:pixels] = rng.uniform(20.0, 20.5, pixels)
    return image


def test_the_step_is_the_finest_in_which_a_message_fits():
    chosen = []
    for pixels in (50, 1200, 1500, 2000, 2400):
        image = RangeImage(SENSOR, rough(pixels), 1.0, 3)
        message = encode_in_packet(image, SCENE)
        step = read_message(message)[0].step
        chosen.append(step)
        assert message == encode_foreground(image, SCENE, step=step)
        steps = list_steps(0.02, 0.32)
        finer = steps[: steps.index(step)]
        sizes = [len(encode_foreground(image, SCENE, step=each)) for each in finer]
        assert all(size > PACKET_BYTES for size in sizes)
        assert len(message) <= PACKET_BYTES or step == 0.32
        restored = decode_foreground(message, SCENE)
        errors = np.abs(restored.image - image.measurement)[restored.sent]
        assert errors.max() <= step / 2 + 1e-5
        assert set(page_reader.read_image(message)[0]) == set(np.flatnonzero(restored.sent))
    assert chosen[0] == 0.02
    assert chosen == sorted(chosen)
    assert len(set(chosen)) >= 3


def test_a_message_that_fits_in_no_step_is_sent_in_the_coarsest():
    image = RangeImage(SENSOR, rough(SHAPE[0] * SHAPE[1]))
    message = encode_in_packet(image, SCENE, max_step=0.04)
    assert len(message) > PACKET_BYTES
    assert message == encode_foreground(image, SCENE, step=0.04)
    assert encode_in_packet(image, SCENE, step=0.08, max_step=0.02) == encode_foreground(
        image, SCENE, step=0.08
    )


def test_steps_are_whole_millimetres_up_to_the_coarsest():
    assert list_steps(0.02, 0.16) == [0.02, 0.028, 0.04, 0.057, 0.08, 0.113, 0.16]
    assert list_steps(0.001, 0.004) == [0.001, 0.002, 0.003, 0.004]
    assert list_steps(0.02, 0.02) == [0.02]
    with pytest.raises(ValueError, match="step must be"):
        list_steps(0.0205, 0.16)
    with pytest.raises(ValueError, match="step must be"):
        Foreground(max_step=0.0)


@pytest.mark.parametrize("pixels", [100, 1000, 2100, 2300, 4000])
def test_estimates_fill_one_packet_at_most(pixels):
    """What is estimated for each frame is bounded, so a mean over frames is too."""
    on_objects = np.array([[pixels, 10]], np.float32)
    counts = SimpleNamespace(sent=on_objects, on_objects=on_objects, far=on_objects)
    adaptive = estimate_bits(Foreground(), PAPER, counts, np.zeros(1))
    by_frame = np.minimum(272 + 5 * np.array([pixels, 10]), 8 * 1398)
    assert adaptive == pytest.approx([by_frame.sum()], abs=1)
    whole = RangeImages().bits(points=Foreground().sent_points(counts)).astype(int)
    assert count_packets(whole).tolist() == [[1, 1]]
    one_step = estimate_bits(Foreground(max_step=0.02), PAPER, counts, np.zeros(1))
    assert one_step == pytest.approx([2 * 272 + 5 * (pixels + 10)])


def test_airtime_is_that_of_802_11p():
    sizes = range(0, 5000, 7)
    bits = 8 * np.array(sizes)
    for size, packets, airtime in zip(
        sizes, count_packets(bits), find_airtime_us(bits), strict=True
    ):
        parts = [1398] * (size // 1398) + [size % 1398] * (size % 1398 > 0)
        assert packets == len(parts)
        # 6 Mbit/s: a symbol of 8 µs holds 48 bits; 126 bytes of headers; 22 bits of service, tail
        symbols = [int(np.ceil((22 + 8 * (126 + part)) / 48)) for part in parts]
        assert airtime == sum(40 + 8 * count for count in symbols)


def with_a_wall(columns):
    """The empty scene with a wall of these columns in front, 12 m away and below the sensor."""
    image = SCENE.first.copy()
    image[22:32, columns] = np.random.default_rng(2).uniform(11.9, 12.1, (10, len(columns)))
    return image


def test_a_frame_comes_back_from_its_message():
    image = with_a_wall(range(10, 40))
    frame = Frame((SENSOR,), (image,), Objects.empty(), 12.5, 125)
    codec = SensorCodec(SENSOR, SCENE, AREA)
    message = codec.encode(frame)
    assert isinstance(message, bytes)
    restored = codec.decode(message)
    assert (restored.time, restored.index, restored.sensors) == (12.5, 125, (SENSOR,))
    (got,) = restored.images
    values, missing = page_reader.read_image(message)
    header = page_reader.read_header(message)
    assert len(values) == 300
    assert not missing
    for pixel in range(image.size):
        expected = values[pixel] * header["step_mm"] / 1000 if pixel in values else 60.0
        assert got.ravel()[pixel] == pytest.approx(expected, abs=1e-4)
    assert np.abs(got - image).ravel()[sorted(values)].max() <= 0.0101
    xyz, valid = unproject(SENSOR, got)
    assert len(restored.points()) == xyz[:, valid].shape[1]


def test_the_codec_takes_its_sensor_out_of_a_frame_and_refuses_others():
    other = replace(SENSOR, name="t")
    wall = with_a_wall(range(10, 40))
    frame = Frame((other, SENSOR), (with_a_wall(range(5)), wall), Objects.empty(), 1.0, 2)
    codec = SensorCodec(SENSOR, SCENE, AREA)
    only_one = Frame((SENSOR,), (wall,), Objects.empty(), 1.0, 2)
    assert codec.encode(frame) == codec.encode(only_one)
    with pytest.raises(ValueError, match="'s'"):
        codec.encode(Frame((other,), (wall,), Objects.empty()))
    with pytest.raises(ValueError, match="the empty scene must be of 't'"):
        SensorCodec(other, SCENE, AREA)
    cloud = SensorCloud("s", np.zeros((1, 3), np.float32), np.eye(4))
    with pytest.raises(ValueError, match="measured a cloud"):
        codec.encode(Frame((SENSOR,), (cloud,), Objects.empty()))
    scene = replace(SCENE, name="t")
    theirs = SensorCodec(other, scene, AREA).encode(frame)
    with pytest.raises(ValueError, match="whose sensor is"):
        codec.decode(theirs)
    message = bytearray(codec.encode(frame))
    message[2] = 1
    with pytest.raises(ValueError, match="checksum"):
        codec.decode(bytes(message))
