"""Views of recordings: parts, classes and sensor errors."""

import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.recordings import open_recording
from toolkit.frame import Frame, Frames, RecordingView
from toolkit.objects import label_index
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS, check_drawn, find_profile, only_own_noise
from toolkit.sensors.readings import TrueImage
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.track_velocities import velocities


def read(
    path: str | Path, layout: str | None = None, *, classes: Sequence[str | int] | None = None
) -> Iterator[Frame]:
    """Open a recording and yield its frames with only their objects of some classes.

    layout: name of its layout, guessed by the path if None; classes: names or numbers, None for
    all. Raises the errors of `open_recording`."""
    return filter_classes(open_recording(path, layout), classes)


def filter_classes(frames: Iterable[Frame], classes: Sequence[str | int] | None) -> Iterator[Frame]:
    """Yield frames with only their objects of some classes, None for all.

    Raises ValueError for an unknown class."""
    if classes is None:
        return (frame for frame in frames)
    class_numbers = [label_index(label) for label in classes]
    return (frame.select_objects(np.isin(frame.objects.labels, class_numbers)) for frame in frames)


@dataclass(frozen=True)
class Part(RecordingView):
    """Part of a recording: every `every`-th frame, and the first `frames` of these, None for all.

    Raises ValueError for numbers below 1, and for a recording without frames."""

    frames: int | None = None
    every: int = 1

    def __post_init__(self) -> None:
        """Raise ValueError for numbers below 1, and for a recording without frames."""
        for name, value in (("every", self.every), ("frames", self.frames)):
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}: leave it out for all")
        if not len(self.recording):
            raise ValueError("there is no frame in the recording: check the path and the layout")

    def __len__(self) -> int:
        count = -(-len(self.recording) // self.every)
        return count if self.frames is None else min(self.frames, count)

    def __getitem__(self, number: int) -> Frame:
        """Return the chosen frame of this number. Raises IndexError for an unknown one."""
        if not 0 <= number < len(self):
            raise IndexError(f"there is no frame {number}: {len(self)} are chosen, counted from 0")
        return self.recording[number * self.every]


@dataclass(frozen=True)
class Numbered(RecordingView):
    """View of a recording whose frames have their numbers as `index`.

    by_name: True if the numbers are the frames' names, as in KITTI, else they count from 0."""

    by_name: bool = False

    def __getitem__(self, index: int) -> Frame:
        frame = self.recording[index]
        number = int(frame.name) if self.by_name else index
        return frame if frame.index == number else replace(frame, index=number)


@dataclass(frozen=True)
class Reads:
    """Options for reading a recording: sensor errors and length.

    errors: a profile or its name, only `paper` for recorded clouds, whose sensors have real errors;
    noise_seed: seed of the errors, None for no noise; frames: number of frames, None for all."""

    errors: ErrorProfile | str = PAPER_ERRORS
    noise_seed: int | None = 0
    frames: int | None = None

    def count(self, recording: Frames) -> int:
        """Return the number of frames to read from a recording.

        Raises ValueError if it is 0, and for a `frames` that is not whole."""
        limit = len(recording) if self.frames is None else self.frames
        total = min(len(recording), limit)
        if total < 1 or isinstance(self.frames, float):
            raise ValueError(
                f"need one frame at least, a whole number, got {self.frames} of {len(recording)}"
            )
        return total

    def profile(self) -> ErrorProfile:
        """Return the error profile.

        Raises ValueError for an unknown name, and for a profile that needs a seed without one."""
        errors = find_profile(self.errors)
        check_drawn(errors, self.noise_seed)
        return errors


@dataclass(frozen=True)
class ReadRecording(RecordingView):
    """View of a recording whose frames have their sensors' errors.

    `reads.frames` does not limit its length."""

    reads: Reads = Reads()

    def __getitem__(self, index: int) -> Frame:
        return read_frame(
            self.recording, index, errors=self.reads.errors, noise_seed=self.reads.noise_seed
        )


def read_frame(
    frames: Frames, k: int, *, errors: ErrorProfile | str = PAPER_ERRORS, noise_seed: int | None = 0
) -> Frame:
    """Read frame k with its sensors' errors, drawn from the seed.

    errors: a profile or its name. A seed of None means no noise, which only `paper` allows.
    Recorded clouds come as they are. Raises ValueError for an unknown profile, a negative seed, a
    profile other than `paper` for recorded clouds, and a clock's offset if frames are too far apart
    to know velocities."""
    errors = find_profile(errors)
    frame = frames[k]
    check_drawn(errors, noise_seed)
    if noise_seed is None:
        return frame
    if not frame.has_images:
        if errors.name != PAPER_ERRORS.name:
            raise ValueError(
                f"recorded clouds have errors of their own, got errors {errors.name!r}: leave "
                "them out"
            )
        return frame
    object_velocities = None
    if errors.needs_velocities:
        neighbours = [frames[index] for index in (k - 1, k + 1) if 0 <= index < len(frames)]
        around = [(neighbour.objects, neighbour.time) for neighbour in neighbours]
        object_velocities = velocities(frame.objects, frame.time, around)
    return with_errors(frame, errors, noise_seed, velocities=object_velocities)


def block_seed(seed: int, block: int) -> int:
    """Return the seed of the sensor errors of one block of frames, from the recording's seed.

    block: number of the block. Other blocks have other errors, as if all sensors were mounted
    again."""
    return int(np.random.default_rng([seed, block]).integers(2**31))


def with_errors(
    frame: Frame,
    errors: ErrorProfile | str,
    seed: int,
    *,
    velocities: Float64[np.ndarray, "n 3"] | None = None,
    numbers: Sequence[int] | None = None,
) -> Frame:
    """Add sensor errors to a frame, drawn from the seed, its index and each sensor's name.

    So a sensor measures the same whichever others are used. velocities: velocities of its objects
    (m/s), needed for a clock's offset; numbers: used instead of the sensors' names when drawing.
    Raises ValueError for a negative seed."""
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    errors = find_profile(errors)
    if numbers is None:
        numbers = [zlib.crc32(sensor.name.encode()) for sensor in frame.sensors]
    numbered_images = list(zip(frame.sensors, frame.images, numbers, strict=True))
    if only_own_noise(errors):  # as `errors.read` draws it
        noisy_images = []
        for sensor, image, number in numbered_images:
            rng = np.random.default_rng([seed, frame.index, number])
            noisy_images.append(sensor.model.noisy(image, rng))
        return replace(frame, measurements=tuple(noisy_images))
    readings = []
    assumed_sensors = []
    for sensor, image, number in numbered_images:
        truth = TrueImage(
            sensor, measurement=image, objects=frame.objects, time=frame.time, velocities=velocities
        )
        reading = errors.read(truth, seed=seed, sensor=number, frame=frame.index)
        readings.append(reading)
        if reading.pose is not sensor.pose:
            sensor = Sensor(sensor.name, sensor.model, reading.pose)
        assumed_sensors.append(sensor)
    measurements = tuple(reading.measurement for reading in readings)
    shifts = tuple(reading.shift for reading in readings)
    shifts = shifts if any(shift is not None for shift in shifts) else ()
    return replace(frame, sensors=tuple(assumed_sensors), measurements=measurements, shifts=shifts)
