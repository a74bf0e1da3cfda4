"""`ForegroundDifferences`: as `Foreground`, but messages say what differs from those before (`link.differences`).

What arrives is the same, to the point, and so is what is detected; only the bytes differ. Who reads frames in order
passes a memory from view to view (`toolkit.detection.view.View`); elsewhere every image is sent whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float32
from toolkit.calibration.empty_scene import SIGMAS
from toolkit.detection.link.differences import (
    KEY_EVERY,
    DifferenceReader,
    DifferenceSender,
    RefersTo,
    check_differences,
)
from toolkit.detection.link.foreground import Foreground, restored_points
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.link.standing_out import standing_out
from toolkit.detection.scheme import Counts, Fused, fused
from toolkit.detection.view import View


@dataclass(frozen=True)
class ForegroundDifferences:
    """step, sigmas: as of `Foreground`; refers_to, key_every: as of `DifferenceSender`. Raises ValueError as these."""

    step: float = 0.02
    refers_to: RefersTo = "previous"
    key_every: int = KEY_EVERY
    sigmas: float = SIGMAS
    name: str = "differences"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = False
    predicted_as: ClassVar[str] = "early"

    def __post_init__(self) -> None:
        Foreground(self.step, self.sigmas)
        check_differences(self.refers_to, self.key_every)

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    @property
    def codec(self) -> RangeImages:
        """What says how many bits so many pixels take, in the mean, where no frame is like the one before."""
        return RangeImages(self.step)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect once in the restored clouds of all sensors together. Raises ValueError where a sensor's empty scene or
        image is not known."""
        sent = [view.transmit(sensor, self.digest, partial(self._through, view, sensor)) for sensor in sensors]
        centre = view.detect([each.arrived for each in sent])
        return fused(view.suppressed([centre]), [each.bits for each in sent])

    def needed(self, number: int, /) -> range:
        """Which messages, counted from a whole image, must have arrived for one to be read, itself the last.

        >>> ForegroundDifferences(key_every=10).needed(12), ForegroundDifferences(refers_to="key").needed(12)
        (range(10, 13), range(10, 13, 2))
        """
        whole = number - number % self.key_every
        return range(whole, number + 1, 1 if self.refers_to == "previous" else max(number - whole, 1))

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> list[int]:
        """The bits that sensors send of a frame, whether or not they arrive."""
        return [view.transmit(sensor, self.digest, partial(self._through, view, sensor)).bits for sensor in sensors]

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """As of `Foreground`."""
        return counts.on_objects

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """No boxes are sent."""

    def _through(self, view: View, sensor: int) -> tuple[Float32[np.ndarray, "n 3"], int]:
        """The restored cloud of a sensor, and the bits of its message."""
        captured, scene = view.captured(sensor), view.scene(sensor)
        sender, reader = view.remembered(sensor, self.digest, lambda: self._begun(view, sensor))
        out = standing_out(captured, scene, self.sigmas)
        message = sender.write(captured.sending(out.pixels), out.missing)
        return restored_points(captured, scene, reader.read(message))[0], 8 * len(message)

    def _begun(self, view: View, sensor: int) -> tuple[DifferenceSender, DifferenceReader]:
        scene = view.scene(sensor)
        sender = DifferenceSender(scene, step=self.step, refers_to=self.refers_to, key_every=self.key_every)
        return sender, DifferenceReader(scene)
