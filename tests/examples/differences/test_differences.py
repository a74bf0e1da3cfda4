"""Messages of one sensor that say what differs from those before: sequences, losses, damage."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from examples.differences import messages as difference_messages
from examples.differences.messages import (
    DifferenceReader,
    DifferenceSender,
    MissedReference,
    check_differences,
)
from examples.differences.reference import (
    Reference,
    decode_difference,
    encode_difference,
    still_squares,
)
from examples.differences.scheme import ForegroundDifferences
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link import foreground, image_coding, range_images
from toolkit.detection.link.image_coding import encode_mask, pack_integers
from toolkit.detection.link.message import MessageHeader, MessageKind, read_message, write_message
from toolkit.detection.messages import RangeImage
from toolkit.detection.scheme import Scheme
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSOR = Sensor("s", DepthCamera(width=160, height=120), pose(0.0, 0.0, 5.0))
SCENE = EmptyScene.from_render(SENSOR, np.full(SENSOR.model.shape, 30, np.float32))

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
    whole = foreground.decode_foreground(
        foreground.encode_foreground(image(k, first=first), SCENE, step=step), SCENE
    )
    np.testing.assert_array_equal(got.image, whole.image)
    np.testing.assert_array_equal(got.sent, whole.sent)
    assert (got.header.number, got.header.time) == (whole.header.number, whole.header.time)


@pytest.mark.parametrize("refers_to", ["previous", "key"])
@pytest.mark.parametrize("step", [0.02, 0.08])
def test_what_arrives_is_what_whole_images_bring_in_fewer_bytes(refers_to, step):
    messages = written(
        DifferenceSender(SCENE, step=step, refers_to=refers_to, key_every=5), 12, first=7
    )
    assert [k for k, kind in enumerate(kinds(messages)) if kind == MessageKind.FOREGROUND] == [
        0,
        5,
        10,
    ]
    assert set(kinds(messages)) == {MessageKind.FOREGROUND, MessageKind.DIFFERENCE}
    reader = DifferenceReader(SCENE)
    for k, message in enumerate(messages):
        restored_alike(reader.read(message), k, step, first=7)
    whole = [foreground.encode_foreground(image(k, first=7), SCENE, step=step) for k in range(12)]
    assert [messages[k] == whole[k] for k in (0, 5, 10)] == [True] * 3
    assert sum(map(len, messages)) < 0.8 * sum(map(len, whole))


def test_what_refers_to_nothing_or_no_sender_writes_is_refused():
    messages = written(DifferenceSender(SCENE, refers_to="previous", key_every=5), 11)
    reader, read = DifferenceReader(SCENE), []
    for k, message in enumerate(messages):
        if k == 2:
            continue
        if k in (3, 4):
            said = (
                f"message {k} refers to message {k - 1}, of which the reader has what message 1 "
                "left: wait for the"
            )
            with pytest.raises(MissedReference, match=said):
                reader.read(message)
            continue
        restored_alike(reader.read(message), k)
        read.append(k)
    assert read == [0, 1, 5, 6, 7, 8, 9, 10]
    with pytest.raises(MissedReference, match="the reader has none"):
        DifferenceReader(SCENE).read(messages[1])
    sender, reader = DifferenceSender(SCENE), DifferenceReader(SCENE)
    whole, message = written(sender, 2)
    reader.read(whole)
    header, content = read_message(message)
    numbers = dict(vars(header))
    for changed, body, said in (
        ({}, content[:5], "at least 6 bytes"),
        ({}, content[:6], "the message is cut off"),
        ({}, b"\0" + content[1:], "1 to 255 back and goes on or not, got 0"),
        ({}, content[:1] + b"\2" + content[2:], "goes on or not, got 1, 2"),
        ({}, b"\2" + content[1:], "refers to message -1"),
        ({"step_mm": 40}, content, "has steps of its reference, 20 mm, got 40 mm"),
        *(({"sensor": 7}, content, "whose sensor is"), ({"scene": 7}, content, "whose scene is")),
        ({"columns": 79}, content, "whose columns is"),
        *(
            ({"rows": 59}, content, "whose rows is"),
            ({"kind": MessageKind.RANGE_IMAGE}, content, "kind difference"),
        ),
    ):
        with pytest.raises(ValueError, match=said):
            reader.read(write_message(MessageHeader(**(numbers | changed)), body))
    restored_alike(reader.read(message), 1)


def test_messages_are_lost_alone_and_new_senders_not_taken_for_old():
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
    first, second = DifferenceSender(SCENE), DifferenceSender(SCENE)
    other = [second.write(image(k, seed=1)) for k in range(2)]
    reader = DifferenceReader(SCENE)
    reader.read(first.write(image(0)))
    with pytest.raises(MissedReference):
        reader.read(other[1])
    restored_alike(reader.read(first.write(image(1))), 1)
    for k, message in enumerate(
        written(DifferenceSender(SCENE), 3)
    ):  # restarted, and counts from 0 again
        restored_alike(reader.read(message), k)


def test_images_are_whole_where_that_is_less_and_pixels_may_be_missing():
    sender = DifferenceSender(SCENE, key_every=10)
    assert kinds(written(sender, 3)) == [2, 5, 5]
    assert kinds([sender.write(image(2)), sender.write(image(1)), sender.write(image(2))]) == [
        2,
        2,
        5,
    ]
    assert kinds([sender.write(image(11)), sender.write(image(20)), sender.write(image(21))]) == [
        2,
        5,
        2,
    ]
    nearer = [RangeImage(SENSOR, image(0).measurement / (k + 1), number=40 + k) for k in range(3)]
    assert kinds([sender.write(each) for each in nearer]) == [2, 2, 2]
    few = np.zeros(SENSOR.model.shape, np.float32)
    few[8:11, 8:12] = 9.0
    assert kinds([sender.write(RangeImage(SENSOR, few, number=50 + k)) for k in range(2)]) == [2, 2]
    assert kinds(written(DifferenceSender(SCENE, key_every=1), 3)) == [2, 2, 2]
    missing = np.zeros(SENSOR.model.shape, bool)
    missing[:, 60:] = True
    sender, reader = DifferenceSender(SCENE), DifferenceReader(SCENE)
    cut = [
        RangeImage(SENSOR, np.where(missing, 0, image(k).measurement), number=k) for k in range(3)
    ]
    messages = [sender.write(each, missing) for each in cut]
    assert kinds(messages) == [2, 5, 5]
    for message in messages:
        restored = reader.read(message)
        np.testing.assert_array_equal(restored.missing, missing)
        assert (restored.image[missing] == 0).all()
    with pytest.raises(ValueError, match="that return nothing"):
        sender.write(image(4), np.ones_like(missing))


def test_damaged_and_encoder_less_differences_are_refused():
    whole, message = written(DifferenceSender(SCENE), 2)
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

    reference, nobody = reference_of([[5, 6, 7]]), np.zeros((1, 3), bool)
    steps, sent = np.array([[5, 6, 7]]), np.ones((1, 3), bool)
    sound = encode_difference(steps, sent, reference, np.ones((1, 1), bool))
    np.testing.assert_array_equal(decode_difference(sound, 0, reference)[0], steps)

    def content(still, others=(), squares=b"\x80"):
        return (
            squares
            + encode_mask(nobody)
            + pack_integers(np.array(still, int))
            + pack_integers(np.array(others, int))
        )

    for wrong, said in (
        *((b"", "do not fit"), (content([0, 0, 0], squares=b"\x81"), "filled with zeros")),
        *(
            (content([0, 0]), "3 pixels stand still, got 2"),
            (content([0, 0, 0], [1]), "0 pixels are marked, got 1"),
        ),
        *(
            (content([0, 0, 15]), "out of range"),
            (content([0, 0, 2 * image_coding.MAX_RANGE_STEPS]), "out of range"),
        ),
        (sound[:-1], "inflate to 0 symbols"),
    ):
        with pytest.raises(ValueError, match=said):
            decode_difference(wrong, 0, reference)
    with pytest.raises(ValueError, match="the reference is an image of"):
        encode_difference(
            np.zeros((2, 3), int), np.ones((2, 3), bool), reference, np.ones((1, 1), bool)
        )


def test_messages_name_the_checksum_of_their_reference():
    first, _, third = written(DifferenceSender(SCENE, refers_to="key"), 3)
    one = image(0)
    steps, sent = (
        range_images.to_steps(one.measurement, one.measurement > 0, 0.02),
        one.measurement > 0,
    )
    reference = Reference.from_image(0, 20, steps, sent)
    assert read_message(third)[1][:6] == struct.pack("<BBI", 2, 0, reference.checksum)
    second = written(DifferenceSender(SCENE), 2)[1]
    assert read_message(second)[1][:6] == struct.pack("<BBI", 1, 1, reference.checksum)
    assert read_message(first)[0].kind == MessageKind.FOREGROUND


def test_checksums_tell_references_apart():
    known = reference_of([[100, 7]], [[1, 0]])
    assert known.checksum == reference_of([[100, 9]], [[1, 0]]).checksum
    assert known.checksum == zlib.crc32(struct.pack("<5q", 3, 20, 0, 1600, 1))
    others = [
        reference_of([[101, 7]], [[1, 0]]),
        reference_of([[100, 100]], [[0, 1]]),
        replace(known, number=4),
        replace(known, step_mm=40),
        replace(known, images=2 * known.images),
        reference_of([[100, 7]]),
    ]
    assert len({each.checksum for each in (known, *others)}) == 7


def test_references_are_means_of_up_to_eight_images():
    reference = reference_of([[100, 100, 100]])
    fine = [[100 * 16.0], [100 * 16.0]]
    for more, value in enumerate([102, 98, 101, 101, 100, 99, 104, 104, 104, 104]):
        reference = reference.after(
            4 + more, np.array([[value, 300, 100]]), np.array([[True, True, False]])
        )
        share = min(more + 2, 8)
        fine[0].append(fine[0][-1] + (16 * value - fine[0][-1]) / share)
        assert abs(reference.fine[0, 0] - fine[0][-1]) <= 1 + more * 0.5
        assert reference.images[0].tolist() == [share, 1 if more == 0 else min(more + 1, 8), 0]
    assert reference.fine[0, 1:].tolist() == [300 * 16, 0]
    assert reference.number == 13


def test_means_are_rounded_half_up():
    exact = reference_of([[10]]).after(4, np.array([[11]]), np.ones((1, 1), bool))
    assert (exact.fine.tolist(), exact.whole_steps.tolist()) == (
        [[168]],
        [[11]],
    )  # 10.5, rounded half up
    assert exact.after(5, np.array([[10]]), np.ones((1, 1), bool)).fine.tolist() == [
        [165]
    ]  # 168 - 8/3, rounded


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"refers_to": "next"}, "previous or key"),
        *(({"key_every": k}, "every 1 to 255") for k in (0, 256, True, 2.5)),
    ],
)
def test_parameters_are_checked(wrong, said):
    with pytest.raises((ValueError, TypeError), match=f"{said}|Type-check"):
        DifferenceSender(SCENE, **wrong)
    for least_or_most in (1, 255):
        assert DifferenceSender(SCENE, key_every=least_or_most).key_every == least_or_most


def reference_of(steps, sent=None, step_mm=20):
    steps = np.array(steps)
    return Reference.from_image(
        3, step_mm, steps, np.ones(steps.shape, bool) if sent is None else np.array(sent, bool)
    )


def sequence(rng, images=4):
    """Images of something that stands still, moves or is none, with noise or without."""
    shape = tuple(rng.integers(1, 30, 2).tolist())
    mask, base = rng.random(shape) < rng.random(), rng.integers(0, 3000, shape)
    for _ in range(images):
        if rng.random() < 0.3:
            mask, base = np.roll(mask, 1, axis=1), np.roll(base, 1, axis=1)
        steps = np.clip(base + rng.integers(-2, 3, shape), 0, None)
        yield steps.astype(np.int64), mask ^ (rng.random(shape) < 0.05)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32), st.booleans())
def test_every_image_comes_back_exactly(seed, any_squares):
    rng = np.random.default_rng(seed)
    reference = None
    for number, (steps, sent) in enumerate(sequence(rng)):
        if reference is not None:
            squares = still_squares(reference, steps, sent)
            squares = rng.random(squares.shape) < 0.5 if any_squares else squares
            content = encode_difference(steps, sent, reference, squares)
            again, marked, end = decode_difference(b"xy" + content + b"z", 2, reference)
            np.testing.assert_array_equal(marked, sent)
            np.testing.assert_array_equal(again, np.where(sent, steps, 0))
            assert end == len(content) + 2
        before = reference or Reference.from_image(number, 20, steps, sent)
        reference = before.after(number, steps, sent)


@pytest.mark.parametrize(
    ("step_mm", "most"), [(20, 4), (40, 2), (80, 1), (200, 1), (5, 16), (30, 3)]
)
def test_eight_centimetres_are_no_motion(step_mm, most):
    reference = reference_of([[100, 100, 100, 100, 100]], [[1, 1, 1, 1, 0]], step_mm)
    steps = np.array([[100 + most, 100 - most, 101 + most, 99 - most, 100]])
    assert reference.standing(steps, np.ones((1, 5), bool)).tolist() == [
        [True, True, False, False, False]
    ]


def test_squares_and_pixels_that_stand_still_take_few_bits():
    reference = reference_of(np.full((8, 20), 50))
    steps = np.full((8, 20), 50)
    steps[:5, 8:16] = 90  # 24 of 64 stand
    steps[:3, :8] = 90  # 40 of 64
    steps[0, 16:] = 90  # 28 of 32
    assert still_squares(reference, steps, np.ones((8, 20), bool)).tolist() == [[True, False, True]]
    assert not still_squares(reference, steps, np.zeros((8, 20), bool)).any()
    one = np.eye(8, dtype=bool) & (np.arange(8) == 3)
    lonely = reference_of(np.full((8, 8), 50), one)
    assert still_squares(lonely, np.full((8, 8), 50), one).tolist() == [[True]]
    assert not still_squares(lonely, np.full((8, 8), 90), one).any()
    for stands, still in ((3, False), (4, True)):  # of five, of which six tenths are three
        five = np.where(np.arange(5) < stands, 50, 90)[None]
        assert still_squares(reference_of([[50] * 5]), five, np.ones((1, 5), bool)).tolist() == [
            [still]
        ]
    rng = np.random.default_rng(0)
    mask = np.zeros((150, 200), bool)
    mask[60:100, 70:130] = True
    base = 500 + np.add.outer(np.zeros(150), np.arange(200) * 0.3) + np.zeros((150, 200))
    images = [np.rint(base + rng.normal(0, 0.75, base.shape)).astype(np.int64) for _ in range(9)]
    reference = Reference.from_image(0, 20, images[0], mask)
    for number, image in enumerate(images[1:8]):
        reference = reference.after(number + 1, image, mask)
    content = encode_difference(
        images[8], mask, reference, still_squares(reference, images[8], mask)
    )
    assert (
        8 * len(content)
        < 2.1 * mask.sum()
        < 0.9 * 8 * len(image_coding.encode_pixels(images[8], mask))
    )
    whole = reference.whole_steps
    same = encode_difference(whole, mask, reference, still_squares(reference, whole, mask))
    assert len(same) < 50


AREA = (-20.0, -20.0, 20.0, 20.0)
SENSORS = tuple(
    Sensor(name, DepthCamera(width=160, height=120), look((x, 0.0, 5.0), 0.0, 0.4))
    for name, x in (("a", 0.0), ("b", 3.0))
)


def ground(sensor):
    down = sensor.world_rays[2].reshape(sensor.model.shape)
    with np.errstate(divide="ignore"):
        measured = (0.1 - sensor.position[2]) / down
    return np.where((down < 0) & (measured < 60), measured, 0).astype(np.float32)


SCENES = [EmptyScene.from_render(sensor, ground(sensor)) for sensor in SENSORS]

ROUGH_GROUND = np.random.default_rng(9).uniform(7, 8, (30, 50))


def frames(count):
    for k in range(count):
        images = []
        for number, sensor in enumerate(SENSORS):
            image = ground(sensor)
            image[22:52, 15:65] = ROUGH_GROUND
            images.append(sensor.model.noisy(image, np.random.default_rng([k, number])))
        yield Frame(SENSORS, tuple(images), Objects.empty(), k / 10, k)


def watched():
    calls = []

    def detector(points):
        calls.append(points)
        return Detections(np.array([[len(points), 0, 1, 4, 2, 1.5, 0.0]]), np.array([0.5]))

    return detector, calls


@pytest.mark.parametrize("refers_to", ["previous", "key"])
def test_the_same_points_arrive_in_fewer_bytes(refers_to):
    scheme, memory, bits = ForegroundDifferences(0.04, refers_to, key_every=4), {}, []
    for frame in frames(6):
        detector, calls = watched()
        view = frame_view(frame, detector, AREA, scene=SCENES.__getitem__, memory=memory)
        whole, got = foreground.Foreground(0.04).fuse(view, [0, 1]), scheme.fuse(view, [0, 1])
        np.testing.assert_array_equal(calls[0], calls[1])
        bits.append((whole.bits, got.bits))
        assert scheme.sent_bits(view, [0, 1]) == got.bits.tolist()
        assert got.ms > 0
    whole, got = np.array(bits).transpose(1, 0, 2)
    assert ((got == whole).all(axis=1)).tolist() == [True, False, False, False, True, False]
    assert (got[[1, 2, 3, 5]] < 0.9 * whole[[1, 2, 3, 5]]).all()
    assert set(memory) == {(0, scheme.digest), (1, scheme.digest)}
    for sensor in range(2):
        sender, reader = memory[sensor, scheme.digest]
        assert (sender.step, sender.refers_to, sender.key_every) == (0.04, refers_to, 4)
        assert sender.scene is reader.scene is SCENES[sensor]


def test_views_that_remember_nothing_and_parameters():
    scheme = ForegroundDifferences()
    for frame in frames(2):
        view = frame_view(frame, watched()[0], AREA, scene=SCENES.__getitem__)
        assert (
            scheme.fuse(view, [0, 1]).bits.tolist()
            == foreground.Foreground().fuse(view, [0, 1]).bits.tolist()
        )
    scheme = ForegroundDifferences()
    assert isinstance(scheme, Scheme)
    assert scheme.digest == (
        "ForegroundDifferences(step=0.02, refers_to='previous', key_every=10, sigmas=4.0, "
        "name='differences')"
    )
    assert (scheme.codec.step, scheme.predicted_as, scheme.sends_points, scheme.sends_boxes) == (
        *(0.02, "early", True, False),
    )
    for wrong, said in (
        ({"step": 0.0}, "step must be"),
        ({"sigmas": 0.0}, "sigmas"),
        ({"key_every": 0}, "every 1"),
    ):
        with pytest.raises(ValueError, match=said):
            ForegroundDifferences(**wrong)


@pytest.mark.parametrize(
    ("refers_to", "number", "needed"),
    [
        *(
            ("previous", 12, [10, 11, 12]),
            ("previous", 10, [10]),
            ("previous", 0, [0]),
            ("key", 13, [10, 13]),
        ),
        *(("key", 11, [10, 11]), ("key", 20, [20])),
    ],
)
def test_which_messages_must_have_arrived(refers_to, number, needed):
    assert list(ForegroundDifferences(refers_to=refers_to).dependencies(number)) == needed


@pytest.fixture
def difference_bytes(monkeypatch):
    """Make every difference so many bytes long, whatever it holds."""

    def set_length(count):
        monkeypatch.setattr(difference_messages, "encode_difference", lambda *_: bytes(count))

    return set_length


@pytest.mark.parametrize(
    ("longer", "kind"),
    [(1, MessageKind.FOREGROUND), (0, MessageKind.FOREGROUND), (-1, MessageKind.DIFFERENCE)],
)
def test_of_two_equally_long_messages_the_whole_image_is_sent(
    limits, difference_bytes, longer, kind
):
    sender = DifferenceSender(SCENE)
    sender.write(image(0))
    second = image(1)
    sent = (second.measurement > 0) & (second.measurement < SENSOR.model.max_range)
    whole = image_coding.encode_pixels(range_images.to_steps(second.measurement, sent, 0.02), sent)
    limits(difference_messages, MIN_STILL_PX=10**9)
    difference_bytes(len(whole) + longer - 6)
    header, content = read_message(sender.write(second))
    assert header.kind == kind
    assert content == whole if kind == MessageKind.FOREGROUND else len(content) == len(whole) - 1


def test_differences_go_on_up_to_the_next_whole_image_and_only_forwards():
    for last, kind in ((9, 5), (10, 2)):
        sender = DifferenceSender(SCENE, key_every=10)
        assert kinds([sender.write(image(0)), sender.write(image(last))]) == [2, kind]
    for key_every in (1, 255):
        check_differences("key", key_every)
    sender = DifferenceSender(SCENE)
    assert (sender.step, sender.refers_to, sender.key_every) == (0.02, "previous", 10)
    assert kinds([sender.write(image(3)), sender.write(image(3))]) == [
        2,
        2,
    ]  # the same number is none after it


def test_whole_images_are_considered_where_few_pixels_stand(limits, difference_bytes):
    """However long the difference is, which is made up."""
    second = image(1)
    sent = (second.measurement > 0) & (second.measurement < SENSOR.model.max_range)
    difference_bytes(10**5)
    for more, kind in ((0, MessageKind.DIFFERENCE), (1, MessageKind.FOREGROUND)):
        sender = DifferenceSender(SCENE)
        sender.write(image(0))
        steps = range_images.to_steps(second.measurement, sent, 0.02)
        stands = int(sender.reference.standing(steps, sent).sum())
        assert stands > 1000
        limits(difference_messages, MIN_STILL_PX=stands + more)
        assert kinds([sender.write(second)]) == [kind]


def test_the_least_and_the_most_steps_stand_still_too():
    most, sent, squares = image_coding.MAX_RANGE_STEPS, np.ones((1, 3), bool), np.ones((1, 1), bool)
    steps = np.array([[0, 7, most - 1]])
    reference = reference_of(steps)
    content = encode_difference(steps, sent, reference, squares)
    assert decode_difference(content, 0, reference)[0].tolist() == steps.tolist()
    for wrong in ([[-1, 7, 7]], [[0, 7, most]]):
        content = encode_difference(np.array(wrong), sent, reference, squares)
        with pytest.raises(ValueError, match="measurements out of range"):
            decode_difference(content, 0, reference)
