"""`FrameDetections`: joint detections of sensor sets in one frame. Each step is done once, for many sets at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float32
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.codec import Codec
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.view import Captured, Cloud, View, together
from toolkit.objects import Detections, Detector, Objects, UnionDetector
from toolkit.points import detect_on_ground, detect_unions_on_ground
from toolkit.runtime.cache import Arrays
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


@runtime_checkable
class Measured(Protocol):
    """Measurements of candidates in frames at a site.

    `placement_env.fidelity.renders.Renders` is one implementation.
    """

    site: Site
    sensors: tuple[Sensor, ...]
    frames: int

    @property
    def digest(self) -> str:
        """Digest of everything behind the measurements except the sensors."""
        ...

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k, with noise. They lie inside the crop."""
        ...

    def objects(self, k: int) -> Objects:
        """All objects present in frame k."""
        ...


@runtime_checkable
class MeasuredImages(Protocol):
    """Measurements of schemes and codecs that send images."""

    @property
    def scene(self) -> Callable[[int], EmptyScene]:
        """Return the empty scene of candidate c."""
        ...

    def captured(self, k: int, c: int) -> Captured:
        """Image behind candidate c's points in frame k."""
        ...


class FrameDetections:
    """Detections in one frame.

    key: under which detections in some clouds are kept; kept: value kept under a key, or None. New detections are
    gathered in `new`.
    """

    def __init__(
        self,
        renders: Measured,
        k: int,
        detector: Detector,
        scheme: Scheme,
        codec: Codec,
        *,
        key: Callable[[Sequence[Cloud]], bytes],
        kept: Callable[[bytes], Arrays | None],
    ) -> None:
        self._site, self._detector, self._scheme = renders.site, detector, scheme
        self._key, self._kept = key, kept
        self._detected: dict[bytes, Detections] = {}
        self._asked: dict[bytes, list[Cloud]] | None = None  # for the next round, of `fuse_together`
        self._fused: dict[tuple[int, ...], Fused] = {(): Fused(Detections.empty(), np.zeros(0, np.int64))}
        self.new: dict[bytes, Arrays] = {}
        images: dict[str, Any] = {}
        if isinstance(renders, MeasuredImages):
            images = {"capture": partial(renders.captured, k), "scene": renders.scene}
        self._view = View(
            renders.site, renders.sensors, measure=partial(renders.clouds, k), run=self._detections, codec=codec,
            **images,
        )  # fmt: skip

    def fused(self, chosen: tuple[int, ...]) -> Fused:
        """Joint detections of a set, and its sensors' bits."""
        if chosen not in self._fused:
            self._fused[chosen] = self._scheme.fuse(self._view, chosen)
        return self._fused[chosen]

    def fuse_together(self, sets: Sequence[tuple[int, ...]]) -> None:
        """Fuse sets with shared batches of detections.

        A detector that gains from many clouds at once works in rounds. Each set advances until it needs an unknown
        detection; all of these are then made together.
        """
        waiting = [chosen for chosen in sets if chosen]
        while isinstance(self._detector, UnionDetector) and len(waiting) > 1:
            asked = self._asked = {}
            waiting = [chosen for chosen in waiting if not self._goes_through(chosen)]
            self._asked = None
            clouds = list(dict.fromkeys(cloud for adding in asked.values() for cloud in adding))
            if len(asked) < 2 or not clouds:
                return
            unions = np.array([[cloud in adding for cloud in clouds] for adding in asked.values()])
            points = [cloud.points for cloud in clouds]
            for key, found in zip(
                asked, detect_unions_on_ground(self._detector, points, unions, self._site), strict=True
            ):
                self._keep(key, found)

    def _goes_through(self, chosen: tuple[int, ...]) -> bool:
        """True where known detections suffice to fuse a set."""
        try:
            self.fused(chosen)
        except _Unknown:
            return False
        return True

    def _detections(self, clouds: Sequence[Cloud]) -> Detections:
        """Joint detections in the points of some clouds."""
        adding = [cloud for cloud in clouds if len(cloud.points)]
        key = self._key(adding)
        if key not in self._detected:
            kept = self._kept(key)
            if kept is not None:
                self._detected[key] = Detections(*kept)
            elif self._asked is not None:
                self._asked[key] = adding
                raise _Unknown
            else:
                self._keep(key, detect_on_ground(self._detector, together(adding), self._site))
        return self._detected[key]

    def _keep(self, key: bytes, found: Detections) -> None:
        self._detected[key] = found
        self.new[key] = found.boxes, found.scores, found.labels


class _Unknown(Exception):
    """A needed detection is left for a later batch."""
