"""`ForegroundDifferences`: as `Foreground`, but messages say what differs from those before (`link.differences`).

What arrives is the same, to the point, and so is what is detected; only the bytes differ. Who reads frames in order
passes a memory from view to view (`toolkit.detection.view.View`); elsewhere every image is sent whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
from toolkit.detection.link.foreground import Foreground, SendsForeground, restored_points
from toolkit.detection.link.standing_out import standing_out
from toolkit.detection.view import View


@dataclass(frozen=True)
class ForegroundDifferences(SendsForeground):
    """step, sigmas: as of `Foreground`; refers_to, key_every: as of `DifferenceSender`. Raises ValueError as these."""

    step: float = 0.02
    refers_to: RefersTo = "previous"
    key_every: int = KEY_EVERY
    sigmas: float = SIGMAS
    name: str = "differences"

    def __post_init__(self) -> None:
        Foreground(self.step, self.sigmas)
        check_differences(self.refers_to, self.key_every)

    def needed(self, number: int, /) -> range:
        """Which messages, counted from a whole image, must have arrived for one to be read, itself the last.

        >>> ForegroundDifferences(key_every=10).needed(12), ForegroundDifferences(refers_to="key").needed(12)
        (range(10, 13), range(10, 13, 2))
        """
        whole = number - number % self.key_every
        return range(whole, number + 1, 1 if self.refers_to == "previous" else max(number - whole, 1))

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> list[int]:
        """The bits that sensors send of a frame, whether or not they arrive."""
        return [self._transmitted(view, sensor).bits for sensor in sensors]

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
