"""`Scheme`: messages of each sensor, fused at the centre.

To add a scheme, write a class with the members of `Scheme` and pass an instance,
`scheme=MyScheme()`; nothing else needs to know about it. `fuse` works on the points themselves. The
other members serve fidelities that only count points: they give the amount of data sent and how
evidence adds up."""

from collections.abc import Sequence
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Bool, Float32, Float64
from toolkit.detection.codec import Codec
from toolkit.detection.parameters import Parameters
from toolkit.detection.view import Fused as Fused, View


@runtime_checkable
class Counts(Protocol):
    """Numbers of points of candidate sensors in some frames."""

    @property
    def sent(self) -> Float32[np.ndarray, "candidates frames"]:
        """Points in the crop."""

    @property
    def on_objects(self) -> Float32[np.ndarray, "candidates frames"]:
        """Points on objects that count, as measured without noise."""

    @property
    def far(self) -> Float32[np.ndarray, "candidates frames"]:
        """Points beyond the site's hybrid radius."""


@runtime_checkable
class Scheme(Protocol):
    """Fusion of the views of a set of sensors."""

    @property
    def name(self) -> str:
        """Name in tables and files."""

    @property
    def digest(self) -> str:
        """Name and parameters, the key of cached results."""

    @property
    def sends_points(self) -> bool:
        """True if sensors send points, which a link may limit."""

    @property
    def sends_boxes(self) -> bool:
        """True if each sensor detects in its points and sends boxes."""

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Fuse what sensors measure in one frame.

        view: the frame as its sensors saw it; sensors: indices in the view, ascending. Returns
        fused boxes, and bits of the sensors in this order."""

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Number of points that each candidate sends in each frame."""

    def mask_pooled(
        self, distance: Float32[np.ndarray, "candidates objects"], radius: float, /
    ) -> Bool[np.ndarray, "candidates objects"] | None:
        """Mark objects whose points reach the centre in addition to boxes.

        distance: distance (m) of objects from candidates; radius: the site's hybrid radius (m).
        Returns None if the centre gets only points or only boxes."""


@runtime_checkable
class Chained(Protocol):
    """Extra members of a scheme whose messages need earlier ones."""

    def dependencies(self, number: int, /) -> Sequence[int]:
        """Numbers of the frames whose messages are needed to read the message of a frame.

        number: number of the frame, which is also the last of the result."""

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> Sequence[int]:
        """Bits that each of some sensors (indices) sends for a frame, arrived or not."""


class DetectsOnce(Parameters):
    """Base of schemes that detect once, in the points of all sensors together: see
    `View.fuse_points`."""

    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = False

    def mask_pooled(
        self, distance: Float32[np.ndarray, "candidates objects"], radius: float, /
    ) -> None:
        """Return None: no boxes are sent."""


def scheme_codec(scheme: Scheme, codec: Codec) -> Codec:
    """Return the `codec` of a scheme if it has one, else the given codec."""
    return getattr(scheme, "codec", codec)


def surrogate_name(scheme: Scheme) -> str:
    """Name of a scheme's surrogate: `predicted_as` if it has one, else the scheme's name."""
    return getattr(scheme, "predicted_as", scheme.name)


def estimate_bits(
    scheme: Scheme, codec: Codec, counts: Counts, box_counts: Float64[np.ndarray, " candidates"]
) -> Float64[np.ndarray, " candidates"]:
    """Expected bits that each candidate sends in all frames, whole numbers.

    codec: codec of the messages, unless the scheme brings another; counts: numbers of points of
    each candidate in each frame; box_counts: number of detections of each candidate in all
    frames."""
    used_codec = scheme_codec(scheme, codec)
    # numbers of points and boxes that each candidate sends in all frames
    sent_points = scheme.sent_points(counts).sum(axis=1, dtype=np.float64)
    sent_boxes = box_counts if scheme.sends_boxes else np.zeros_like(box_counts)
    message_count = counts.sent.shape[1]  # one in each frame
    return np.rint(used_codec.bits(points=sent_points, boxes=sent_boxes, messages=message_count))
