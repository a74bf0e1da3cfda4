"""Messages of one sensor that say what differs from those before: sequences, losses, damage."""

import struct
import zlib

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.difference_coding import Reference
from toolkit.detection.link.differences import DifferenceReader, DifferenceSender, MissedReference
from toolkit.detection.link.foreground import decode_foreground, encode_foreground
from toolkit.detection.link.message import MessageHeader, MessageKind, read_message, write_message
from toolkit.detection.link.range_images import to_steps
from toolkit.geometry import pose
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSOR = Sensor("s", DepthCamera(width=160, height=120), pose(0.0, 0.0, 5.0))
SCENE = EmptyScene.of(SENSOR, np.full(SENSOR.model.shape, 30, np.float32))

ROUGH = np.random.default_rng(9).uniform(12, 13, (30, 60))


def image(number, seed=0, first=0):
    """A car that stands, of which noise and the edge change, and one that passes."""
    rng, measured = np.random.default_rng([seed, number]), np.zeros(SENSOR.model.shape, np.float32)
    standing = measured[8:38, 5:65]
    standing[:] = ROUGH + rng.normal(0, 0.015, standing.shape)
    measured[7, 5:65][rng.random(60) < 0.5] = 12.3
    column = (2 * number) % 70
    measured[44:50, column : column + 8] = 8 - 0.1 * number
    return RangeImage(SENSOR, measured, time=number / 10, number=number + first)


def written(sender, count, first=0):
    return [sender.write(image(k, first=first)) for k in range(count)]


def kinds(messages):
    return [read_message(message)[0].kind for message in messages]


def restored_alike(got, k, step=0.02, first=0):
    whole = decode_foreground(encode_foreground(image(k, first=first), SCENE, step=step), SCENE)
    np.testing.assert_array_equal(got.image, whole.image)
    np.testing.assert_array_equal(got.sent, whole.sent)
    assert (got.header.number, got.header.time) == (whole.header.number, whole.header.time)


@pytest.mark.parametrize("refers_to", ["previous", "key"])
@pytest.mark.parametrize("step", [0.02, 0.08])
def test_what_arrives_is_what_whole_images_bring_in_fewer_bytes(refers_to, step):
    messages = written(DifferenceSender(SCENE, step=step, refers_to=refers_to, key_every=5), 12, first=7)
    assert [k for k, kind in enumerate(kinds(messages)) if kind == MessageKind.FOREGROUND] == [0, 5, 10]
    assert set(kinds(messages)) == {MessageKind.FOREGROUND, MessageKind.DIFFERENCE}
    reader = DifferenceReader(SCENE)
    for k, message in enumerate(messages):
        restored_alike(reader.read(message), k, step, first=7)
    whole = [encode_foreground(image(k, first=7), SCENE, step=step) for k in range(12)]
    assert [messages[k] == whole[k] for k in (0, 5, 10)] == [True] * 3
    assert sum(map(len, messages)) < 0.8 * sum(map(len, whole))


def test_without_what_a_difference_refers_to_it_is_refused_until_the_next_whole_image():
    messages = written(DifferenceSender(SCENE, refers_to="previous", key_every=5), 11)
    reader, read = DifferenceReader(SCENE), []
    for k, message in enumerate(messages):
        if k == 2:
            continue
        if k in (3, 4):
            said = f"message {k} refers to message {k - 1}, of which the reader has what message 1 left: wait for the"
            with pytest.raises(MissedReference, match=said):
                reader.read(message)
            continue
        restored_alike(reader.read(message), k)
        read.append(k)
    assert read == [0, 1, 5, 6, 7, 8, 9, 10]
    with pytest.raises(MissedReference, match="the reader has none"):
        DifferenceReader(SCENE).read(messages[1])


def test_of_differences_from_whole_images_each_is_lost_alone():
    messages = written(DifferenceSender(SCENE, refers_to="key", key_every=5), 10)
    reader, read = DifferenceReader(SCENE), []
    for k, message in enumerate(messages):
        if k in (2, 3, 5):
            continue
        try:
            restored_alike(reader.read(message), k)
            read.append(k)
        except MissedReference:
            pass
    assert read == [0, 1, 4]
    again = DifferenceReader(SCENE)
    for k in (0, 4, 1, 1, 4):
        restored_alike(again.read(messages[k]), k)


def test_a_sender_that_began_anew_is_not_taken_for_the_one_before():
    first, second = DifferenceSender(SCENE), DifferenceSender(SCENE)
    other = [second.write(image(k, seed=1)) for k in range(2)]
    reader = DifferenceReader(SCENE)
    reader.read(first.write(image(0)))
    with pytest.raises(MissedReference):
        reader.read(other[1])
    restored_alike(reader.read(first.write(image(1))), 1)


def test_images_are_whole_where_numbers_do_not_go_on_nothing_stands_or_whole_is_less():
    sender = DifferenceSender(SCENE, key_every=10)
    assert kinds(written(sender, 3)) == [2, 5, 5]
    assert kinds([sender.write(image(2)), sender.write(image(1)), sender.write(image(2))]) == [2, 2, 5]
    assert kinds([sender.write(image(11)), sender.write(image(20)), sender.write(image(21))]) == [2, 5, 2]
    nearer = [RangeImage(SENSOR, image(0).measurement / (k + 1), number=40 + k) for k in range(3)]
    assert kinds([sender.write(each) for each in nearer]) == [2, 2, 2]
    few = np.zeros(SENSOR.model.shape, np.float32)
    few[8:11, 8:12] = 9.0
    assert kinds([sender.write(RangeImage(SENSOR, few, number=50 + k)) for k in range(2)]) == [2, 2]
    assert kinds(written(DifferenceSender(SCENE, key_every=1), 3)) == [2, 2, 2]


def test_missing_pixels_arrive_with_differences():
    missing = np.zeros(SENSOR.model.shape, bool)
    missing[:, 60:] = True
    sender, reader = DifferenceSender(SCENE), DifferenceReader(SCENE)
    cut = [RangeImage(SENSOR, np.where(missing, 0, image(k).measurement), number=k) for k in range(3)]
    messages = [sender.write(each, missing) for each in cut]
    assert kinds(messages) == [2, 5, 5]
    for message in messages:
        restored = reader.read(message)
        np.testing.assert_array_equal(restored.missing, missing)
        assert (restored.image[missing] == 0).all()
    with pytest.raises(ValueError, match="that return nothing"):
        sender.write(image(4), np.ones_like(missing))


def test_two_thousand_damaged_differences():
    sender = DifferenceSender(SCENE)
    whole, message = written(sender, 2)
    rng, read = np.random.default_rng(0), 0
    reader = DifferenceReader(SCENE)
    reader.read(whole)
    for _ in range(2000):
        mutant = bytearray(message)
        for at in rng.integers(0, len(message), rng.integers(1, 4)):
            mutant[at] = rng.integers(256)
        mutant = mutant[: rng.integers(len(mutant))] if rng.random() < 0.2 else mutant
        if mutant == message:
            continue
        with pytest.raises(ValueError, match=r"checksum|cut off"):
            reader.read(bytes(mutant))
        resealed = bytes(mutant[:-4]) + struct.pack("<I", zlib.crc32(mutant[:-4]))
        try:
            restored = reader.read(resealed)
        except ValueError:
            continue
        read += 1
        assert np.isfinite(restored.image).all()
        reader.read(whole)
    assert read < 1000
    restored_alike(reader.read(message), 1)


def test_what_no_sender_writes_is_refused():
    sender, reader = DifferenceSender(SCENE), DifferenceReader(SCENE)
    whole, message = written(sender, 2)
    reader.read(whole)
    header, content = read_message(message)
    numbers = dict(vars(header))
    for changed, body, said in (
        ({}, content[:5], "at least 6 bytes"),
        ({}, b"\0" + content[1:], "1 to 255 messages back and goes on or not, got 0"),
        ({}, content[:1] + b"\2" + content[2:], "goes on or not, got 1, 2"),
        ({}, b"\2" + content[1:], "refers to message -1"),
        ({"step_mm": 40}, content, "has steps of its reference, 20 mm, got 40 mm"),
        ({"sensor": 7}, content, "whose sensor is"),
        ({"scene": 7}, content, "whose scene is"),
        ({"rows": 59}, content, "whose rows is"),
        ({"kind": MessageKind.RANGE_IMAGE}, content, "kind difference"),
    ):
        with pytest.raises(ValueError, match=said):
            reader.read(write_message(MessageHeader(**(numbers | changed)), body))
    restored_alike(reader.read(message), 1)


def test_what_a_difference_says_of_what_it_refers_to():
    first, _, third = written(DifferenceSender(SCENE, refers_to="key"), 3)
    one = image(0)
    steps, sent = to_steps(one.measurement, one.measurement > 0, 0.02), one.measurement > 0
    reference = Reference.of(0, 20, steps, sent)
    assert read_message(third)[1][:6] == struct.pack("<BBI", 2, 0, reference.checksum)
    second = written(DifferenceSender(SCENE), 2)[1]
    assert read_message(second)[1][:6] == struct.pack("<BBI", 1, 1, reference.checksum)
    assert read_message(first)[0].kind == MessageKind.FOREGROUND


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"refers_to": "next"}, "previous or key"), *(({"key_every": k}, "every 1 to 255") for k in (0, 256, True, 2.5))],
)
def test_parameters_are_checked(wrong, said):
    with pytest.raises((ValueError, TypeError), match=f"{said}|Type-check"):
        DifferenceSender(SCENE, **wrong)
