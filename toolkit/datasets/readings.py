"""A frame as real sensors would measure it, with errors that are drawn when the frame is read. Sensors stand at their
believed poses, and their measurements are those of their true poses. Objects stay the truth."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Float64
from toolkit.frame import Frame, Frames, RecordingView
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile, check_drawn, find_profile, only_own_noise
from toolkit.sensors.error_terms import TrueImage, velocities
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True)
class Reads:
    """Options for reading a recording: sensor errors and length.

    errors: a profile or its name, only `paper` for recorded clouds, whose sensors have errors of their own; noise_seed:
    of the errors, None for no noise; frames: read only the first ones.
    """

    errors: ErrorProfile | str = PAPER_ERRORS
    noise_seed: int | None = 0
    frames: int | None = None

    def count(self, recording: Frames) -> int:
        """Number of frames to be read. Raises ValueError if it is 0, and for a `frames` that is not whole."""
        total = min(len(recording), len(recording) if self.frames is None else self.frames)
        if total < 1 or isinstance(self.frames, float):
            raise ValueError(f"need one frame at least, a whole number, got {self.frames} of {len(recording)}")
        return total

    def profile(self) -> ErrorProfile:
        """Return the error profile. Raises ValueError."""
        errors = find_profile(self.errors)
        check_drawn(errors, self.noise_seed)
        return errors


@dataclass(frozen=True)
class ReadRecording(RecordingView):
    """A recording with its sensors' errors, without limit on frames."""

    reads: Reads = Reads()

    def __getitem__(self, index: int) -> Frame:
        return read_frame(self.recording, index, errors=self.reads.errors, noise_seed=self.reads.noise_seed)


def read_frame(
    frames: Frames, k: int, *, errors: ErrorProfile | str = PAPER_ERRORS, noise_seed: int | None = 0
) -> Frame:
    """Read frame k with its sensors' errors, drawn from the seed; None for no noise, which only `paper` allows. Raises
    ValueError for an unknown profile, a negative seed, and a clock's offset if frames lie too far apart to know
    velocities."""
    errors, frame = find_profile(errors), frames[k]
    check_drawn(errors, noise_seed)
    if noise_seed is None or not frame.has_images:
        if noise_seed is not None and errors.name != PAPER_ERRORS.name:
            raise ValueError(f"recorded clouds have errors of their own, got errors {errors.name!r}: leave them out")
        return frame
    speed = None
    if errors.needs_velocities:
        around = [frames[other] for other in (k - 1, k + 1) if 0 <= other < len(frames)]
        speed = velocities(frame.objects, frame.time, [(each.objects, each.time) for each in around])
    return with_errors(frame, errors, noise_seed, velocities=speed)


def block_seed(seed: int, block: int) -> int:
    """Seed of the errors of one block of frames, as if all sensors were mounted anew."""
    return int(np.random.default_rng([seed, block]).integers(2**31))


def with_errors(
    frame: Frame,
    errors: ErrorProfile | str,
    seed: int,
    *,
    velocities: Float64[np.ndarray, "n 3"] | None = None,
    numbers: Sequence[int] | None = None,
) -> Frame:
    """Add sensor errors to a frame, drawn from the seed, its index and each sensor's name, so that a sensor measures
    the same whichever others are used. velocities: of its objects (m/s), needed for a clock's offset; numbers: in place
    of the sensors' names when drawing. Raises ValueError for a negative seed."""
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    errors = find_profile(errors)
    numbers = [zlib.crc32(sensor.name.encode()) for sensor in frame.sensors] if numbers is None else numbers
    each_sensor = list(zip(frame.sensors, frame.images, numbers, strict=True))
    if only_own_noise(errors):  # as `errors.read` draws it
        rngs = [np.random.default_rng([seed, frame.index, number]) for number in numbers]
        drawn = [each.model.noisy(image, rng) for (each, image, _), rng in zip(each_sensor, rngs, strict=True)]
        return replace(frame, measurements=tuple(drawn))
    readings, believed = [], []
    for sensor, measurement, number in each_sensor:
        true = TrueImage(sensor, measurement, frame.objects, frame.time, velocities)
        reading = errors.read(true, seed=seed, sensor=number, frame=frame.index)
        readings.append(reading)
        believed.append(sensor if reading.pose is sensor.pose else Sensor(sensor.name, sensor.model, reading.pose))
    measurements, shifts = (tuple(getattr(each, name) for each in readings) for name in ("measurement", "shift"))
    shifts = shifts if any(shift is not None for shift in shifts) else ()
    return replace(frame, sensors=tuple(believed), measurements=measurements, shifts=shifts)
