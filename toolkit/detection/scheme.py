"""`Scheme`: what each sensor of a set computes and sends, and what the fusion centre makes of it.

A scheme of your own is a class with the members of `Scheme`, in a file of its own; it is passed as an object,
`scheme=MyScheme()`, and nothing else needs to know of it. `fuse` works on the points themselves; the other members tell
the fidelities that only count points what is sent and how evidence adds up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.detection.codec import Codec
from toolkit.detection.view import Boxes, View
from toolkit.objects import Detections


@dataclass(frozen=True)
class Fused:
    """What the fusion centre reports for a frame, and the bits that each sensor sent, in the order they were named. ms:
    from measurement to fused boxes, the sensors working side by side."""

    detections: Detections
    bits: Int64[np.ndarray, " sensors"]
    ms: float = 0.0

    @property
    def kbit_per_sensor(self) -> float:
        """Mean over the sensors, 1 kbit = 1000 bit (paper section IV-A); 0 without sensors."""
        return float(self.bits.mean()) / 1000 if len(self.bits) else 0.0


def fused(boxes: Boxes, bits: Sequence[int]) -> Fused:
    """What the centre has in the end, and what each sensor sent."""
    return Fused(boxes.detections, np.array(bits, np.int64), boxes.ms)


@runtime_checkable
class Counts(Protocol):
    """What C candidates see in F frames, counted: such as `placement_env.fidelity.visibility.Visibility`."""

    @property
    def sent(self) -> Float32[np.ndarray, "C F"]:
        """Points in the crop."""
        ...

    @property
    def on_objects(self) -> Float32[np.ndarray, "C F"]:
        """Those of them on objects that count, noise-free."""
        ...

    @property
    def far(self) -> Float32[np.ndarray, "C F"]:
        """Those of them beyond the site's hybrid radius."""
        ...


@runtime_checkable
class Scheme(Protocol):
    """How a set of sensors fuses what it sees."""

    @property
    def name(self) -> str:
        """In tables and files."""
        ...

    @property
    def digest(self) -> str:
        """Name and parameters: what is kept on disk is kept under it."""
        ...

    @property
    def sends_points(self) -> bool:
        """Whether sensors send points: a mount's link limits who can; boxes alone always fit."""
        ...

    @property
    def sends_boxes(self) -> bool:
        """Whether each sensor detects by itself and sends boxes."""
        ...

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """What a set of sensors (indices, ascending) detects together in a frame, and what each of them sent."""
        ...

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """How many points each candidate sends in each frame."""
        ...

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> Bool[np.ndarray, "C O"] | None:
        """Where a sensor's points on an object reach the centre beside the boxes of its own; None where the centre
        works with points alone or boxes alone. radius: the site's hybrid radius (m)."""
        ...


@runtime_checkable
class Chained(Protocol):
    """What a `Scheme` has besides whose messages can only be read after others: a lost one takes more with it."""

    def needed(self, number: int, /) -> Sequence[int]:
        """Which messages of a sensor, counted from 0, must have arrived for one to be read, itself the last."""
        ...

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> Sequence[int]:
        """The bits that sensors send of a frame, whether or not they arrive; views share a memory, frame by frame."""
        ...


def codec_for(scheme: Scheme, codec: Codec) -> Codec:
    """By which a scheme sends: its own, its attribute `codec`, where it has one, else the one given."""
    return getattr(scheme, "codec", codec)


def predicted_as(scheme: Scheme) -> str:
    """The name of the scheme whose surrogate predicts the AP of this one: its attribute `predicted_as`, where it
    detects in the same points as that, else its own."""
    return getattr(scheme, "predicted_as", scheme.name)


def bits_sent(
    scheme: Scheme, codec: Codec, counts: Counts, boxes: Float64[np.ndarray, " C"]
) -> Float64[np.ndarray, " C"]:
    """Expected bits that each candidate sends in all frames together, a whole number; boxes: how many it detects in
    them all."""
    codec = codec_for(scheme, codec)
    points = scheme.sent_points(counts).sum(axis=1, dtype=np.float64)
    boxes = boxes if scheme.sends_boxes else np.zeros_like(boxes)
    return np.rint(codec.bits(points=points, boxes=boxes, messages=counts.sent.shape[1]))
