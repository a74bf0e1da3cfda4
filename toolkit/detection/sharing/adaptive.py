"""`Adaptive`: within a budget of bits per frame, each sensor's evidence of an object arrives as a box or as points.

1. A sensor whose whole foreground fits its budget, in steps of 2, 4 or 8 cm, sends that. Each other detects in its own
   points and sends its boxes, the surest first, as many as fit.
2. The centre detects in the points that came and asks the others for the foreground of places where boxes are unsure or
   disagree (`wants`), by gain per bit.
3. A sensor answers with pieces of its foreground (`foreground_groups`): those asked for, then those that no box of its
   own explains, then the others; as many as fit, in whichever step is worth most.
4. The centre draws the empty scene beside what arrived, as `Foreground` does, detects in the points of all, and joins
   the boxes of those sensors whose points of that object did not arrive.

Foreground, boxes, requests and answers are messages as bytes, and all of them count. With budget for nothing a sensor
is silent, with little all is late fusion, with enough the scheme `Foreground`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from time import perf_counter
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float32, Int64
from toolkit.boxes import count_points, iou_bev
from toolkit.calibration.empty_scene import SIGMAS
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.scheme import Counts, Fused, fused
from toolkit.detection.sharing.answers import answered, requested, restored, unanswered, whole_foreground
from toolkit.detection.sharing.requests import MOST_GRANT
from toolkit.detection.sharing.wants import Wants, granted, wanted
from toolkit.detection.view import Boxes, Cloud, View
from toolkit.objects import Detections

SMALL_WISH = 500.0  # bits that each sensor is granted a share for beside what it is asked


@dataclass(frozen=True, eq=False)
class _Sender:
    """What the centre has of a sensor. boxes: those whose points did not arrive; foreground: its message; whole:
    whether that is all it has; bits: sent to and fro."""

    sensor: int
    boxes: Boxes
    foreground: bytes | None
    whole: bool
    bits: int


@dataclass(frozen=True)
class Adaptive:
    """Boxes and as much foreground as fit. budget_bits: that a sensor may send and be sent in a frame, requests
    counted; whole_link: all sensors together; sigmas: as of `Foreground`. Raises ValueError for a budget below 0."""

    budget_bits: int = 3000
    whole_link: bool = False
    sigmas: float = SIGMAS
    name: str = "adaptive"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        whole = isinstance(self.budget_bits, int | np.integer) and not isinstance(self.budget_bits, bool)
        if not (whole and 0 <= self.budget_bits <= MOST_GRANT):
            raise ValueError(f"budget_bits must be a whole number from 0 to {MOST_GRANT}, got {self.budget_bits!r}")
        Foreground(sigmas=self.sigmas)

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    @property
    def codec(self) -> RangeImages:
        """In which boxes are sent."""
        return RangeImages()

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Foreground or boxes, requests, answers, fusion. Raises ValueError where a sensor's empty scene or image is
        not known."""
        share = self.budget_bits // max(len(sensors), 1) if self.whole_link else self.budget_bits
        senders = [self._first(view, sensor, share) for sensor in sensors]
        if not all(each.whole for each in senders):
            senders = self._asked(view, senders)
        parts = [each.boxes for each in senders]
        if any(each.foreground for each in senders):
            clouds, measured = zip(*(self._cloud(view, each) for each in senders), strict=True)
            centre = view.detect(clouds)
            parts = [centre, *(_outdone(each, centre, measured, view.nms_iou) for each in parts)]
        return fused(view.suppressed(parts), [each.bits for each in senders])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """Raises ValueError: which points are sent depends on what all sensors of a set detect."""
        raise ValueError("what adaptive sharing sends is not known from counts of points: say --fidelity detector")

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """Which points reach the centre beside boxes depends on what all sensors of a set detect."""

    def _first(self, view: View, sensor: int, most_bits: int) -> _Sender:
        """What a sensor sends unasked."""
        ready, start = view.cloud(sensor).ms, perf_counter()
        message = whole_foreground(view.captured(sensor), view.scene(sensor), most_bits, self.sigmas)
        ms = ready + (perf_counter() - start) * 1e3
        if message is not None:
            return _Sender(sensor, Boxes(Detections.empty(), ms), message, True, 8 * len(message))
        boxes, bits = _sent_boxes(view.detect([view.cloud(sensor)]), most_bits)
        return _Sender(sensor, boxes, None, False, bits)

    def _asked(self, view: View, senders: Sequence[_Sender]) -> list[_Sender]:
        """The same after the answers to what the centre asks."""
        parts = [each.boxes for each in senders]
        complete = [k for k, each in enumerate(senders) if each.whole]
        if complete:
            parts[complete[0]] = view.detect([self._cloud(view, senders[k])[0] for k in complete])
        joined, models = view.suppressed(parts), [view.sensors[each.sensor] for each in senders]
        wants = wanted(joined.detections, [each.detections for each in parts], models, same_iou=view.nms_iou)
        after = []
        for k, (each, most) in enumerate(zip(senders, self._left(wants, senders).tolist(), strict=True)):
            start, captured = perf_counter(), view.captured(each.sensor)
            request = None if each.whole else requested(wants, k, most, captured)
            if request is None:
                after.append(each)
                continue
            scene, own = view.scene(each.sensor), each.boxes.detections
            answer = answered(captured, scene, request, own, self.sigmas)
            ms = joined.ms + (perf_counter() - start) * 1e3
            kept = Boxes(unanswered(own, restored(captured, scene, answer)[1]), ms)
            after.append(_Sender(each.sensor, kept, answer, False, each.bits + 8 * (len(request) + len(answer or b""))))
        return after

    def _left(self, wants: Wants, senders: Sequence[_Sender]) -> Int64[np.ndarray, " sensors"]:
        """Bits left to each sensor that has not sent all it has; those of a link go where most is wanted."""
        bits = np.array([each.bits for each in senders], np.int64)
        if not self.whole_link:
            return self.budget_bits - bits
        open_ends = np.array([not each.whole for each in senders])
        return granted(self.budget_bits - int(bits.sum()), (wants.bits.sum(axis=1) + SMALL_WISH) * open_ends)

    def _cloud(self, view: View, sender: _Sender) -> tuple[Cloud, Float32[np.ndarray, "m 3"]]:
        """The cloud of a sensor at the centre, and of it the points that were sent."""
        start = perf_counter()
        points, measured = restored(view.captured(sender.sensor), view.scene(sender.sensor), sender.foreground)
        name = f"{self.digest} {sha256(sender.foreground or b'').hexdigest()}"
        return Cloud(sender.sensor, (name,), points, sender.boxes.ms + (perf_counter() - start) * 1e3), measured


def _sent_boxes(boxes: Boxes, most_bits: int) -> tuple[Boxes, int]:
    """Boxes as they arrive, the surest first, as many as fit so many bits, and the bits of their message; a sensor that
    has none sends none."""
    codec, start = RangeImages(), perf_counter()
    order = np.argsort(-boxes.detections.scores, kind="stable")
    for count in range(len(order), 0, -1):
        message = codec.encode_boxes(boxes.detections[order[:count]])
        if message.bits <= most_bits:
            arrived = codec.decode_boxes(message)
            return Boxes(arrived, boxes.ms + (perf_counter() - start) * 1e3), message.bits
    return replace(boxes, detections=Detections.empty()), 0


def _outdone(own: Boxes, centre: Boxes, measured: Sequence[Float32[np.ndarray, "_ 3"]], same_iou: float) -> Boxes:
    """Boxes of a sensor, less those of objects that the centre detects in points of two sensors or more."""
    found = centre.detections.boxes
    support = sum((count_points(points, found) > 0).astype(int) for points in measured)
    outdone = iou_bev(own.detections.boxes, found[np.asarray(support) > 1]) > same_iou
    return replace(own, detections=own.detections[~outdone.any(axis=1)])
