"""Fused detections and truth of each frame, by every scheme and sensor set."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from time import perf_counter

import numpy as np

from toolkit.boxes import count_points
from toolkit.calibration.place import Place, Stand
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.recording_views import ReadRecording
from toolkit.detection.breakdown import FrameTruth, select_truth
from toolkit.detection.codec import Codec, ImageCodec, check_codec
from toolkit.detection.comparison import Comparison, Scoring
from toolkit.detection.scheme import Fused, Scheme, scheme_codec
from toolkit.detection.view import LinkMemory, View, stand_view
from toolkit.frame import Frame, select_sensors
from toolkit.objects import Detections, Detector
from toolkit.points import detect_on_ground, has_centre_inside
from toolkit.sites.site import Site


def sends_images(scheme: Scheme | None, codec: Codec) -> bool:
    """True if sensors of a scheme send points as pixels of their images.

    scheme: None for detection in all clouds together, without messages; codec: codec of schemes
    that do not bring another."""
    if scheme is None or not scheme.sends_points:
        return False
    return isinstance(scheme_codec(scheme, codec), ImageCodec)


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Truth of one frame, and the result of each scheme and sensor set.

    Attributes:
        truth: objects of the frame, with a mask of the objects to find.
        fused: fused detections (world frame), by the scheme's name and the set's sensors (indices).
        problems: number of labels and points left out in reading, by kind.
        level_ms: milliseconds that finding the ground took.
        warning: warning of ground that is not level, None without one.
        read_ms: milliseconds until the frame was there.
    """

    truth: FrameTruth
    fused: dict[tuple[str, tuple[int, ...]], Fused]
    problems: Mapping[str, int]
    level_ms: float
    warning: str | None = None
    read_ms: float = 0.0


@dataclass(frozen=True)
class ScoringJob:
    """Scores frames one after another; pickled to other processes.

    Attributes:
        recording: frames with the sensors' errors.
        detector: detector of all schemes.
        comparison: settings, as the caller gave them.
        place: detection area and ground.
        site: site of the recording, None if unknown.
        at_site: True if detection is in the site's area, on its ground; else each frame's ground is
            found, and points are counted from the middle of the area.
        schemes: schemes by name, None for detection in all clouds together, uncropped.
        sets: names of the sensors in each set, by the set's indices in the first frame.
        scenes: empty scenes of the sensors, learnt when a scheme first needs them.
        protocol: rule for the objects that count (see `toolkit.detection.evaluation`).
        count_points: whether points on objects are counted, for a breakdown.
    """

    recording: ReadRecording
    detector: Detector
    comparison: Comparison
    place: Place
    site: Site | None
    at_site: bool
    schemes: dict[str, Scheme | None]
    sets: dict[tuple[int, ...], tuple[str, ...]]
    scenes: Scenes
    protocol: Scoring
    count_points: bool

    def __call__(self, numbers: Sequence[int]) -> list[FrameResult]:
        """Results of the frames with these numbers in the recording, in that order."""
        return list(self.score((self.recording[k] for k in numbers), numbers))

    def score(self, frames: Iterable[Frame], numbers: Iterable[int]) -> Iterator[FrameResult]:
        """Yield the results of each frame, in order.

        numbers: number of each frame in the recording, which messages carry. What sensors and
        centre remember of earlier messages is kept from frame to frame as long as the sensors'
        names stay the same."""
        # away from the site, sensors in no set are left out, as the ground is found from the
        # points; a set of None has all sensors
        if None not in self.comparison.sensor_sets and not self.at_site:
            set_names = list(dict.fromkeys(chain.from_iterable(self.sets.values())))
            frames = (frame.seen_by(set_names) for frame in frames)
        memory = LinkMemory()
        previous_names = list[str]()
        stands = self.place.stands(frames, self.site)  # each frame with its ground and area
        end = perf_counter()  # end of the frame before
        for number, (frame, stand) in zip(numbers, stands, strict=True):
            read_ms = 1e3 * (perf_counter() - end) - stand.ms
            names = [sensor.name for sensor in frame.sensors]
            if names != previous_names:
                memory = LinkMemory()
            previous_names = names
            numbered_frame = frame if frame.index == number else replace(frame, index=number)
            fused = self._fuse(numbered_frame, stand, memory)
            truth = self._find_truth(frame, stand)
            yield FrameResult(
                truth,
                fused,
                frame.problems,
                level_ms=stand.ms,
                warning=stand.warning,
                read_ms=read_ms,
            )
            end = perf_counter()

    def describe(self, ious: Mapping[str, tuple[float, ...]], **reads: object) -> dict[str, object]:
        """Settings that the figures depend on, for their provenance.

        ious: IoU thresholds of each class, by its name; reads: number of frames and errors of the
        sensors, entered as given."""
        settings: dict[str, object] = {
            "site": self.site and self.site.name,  # None if the site is unknown
            "hybrid_radius": self.site and self.site.hybrid_radius,
            **reads,
            "nms_iou": self.comparison.nms_iou,
            "metric": self.comparison.metric,
            "protocol": self.protocol,
        }
        if self.scenes.used:
            settings["empty_scenes"] = self.scenes.digests
        if len(ious) == 1:
            label = next(iter(ious))
            settings |= {"label": label, "iou": list(ious[label])}
        else:
            settings["classes"] = ious
        settings["schemes"] = {
            name: "all clouds at once" if scheme is None else scheme.digest
            for name, scheme in self.schemes.items()
        }
        return settings

    def _find_truth(self, frame: Frame, stand: Stand) -> FrameTruth:
        """Objects of a frame, with a mask of the objects that count by the protocol.

        stand: area of the frame. Numbers of points on objects stay 0 if they are not needed."""
        if self.protocol == "measured":
            return select_truth(frame, stand.corners)
        objects = frame.objects
        is_inside = has_centre_inside(objects.boxes, stand.corners)
        point_counts = np.zeros(len(is_inside), np.int64)
        if self.count_points:
            point_counts = count_points(frame.points(), objects.boxes)
        if self.protocol == "published":  # objects outside the area are removed
            objects = objects[is_inside]
            point_counts = point_counts[is_inside]
            is_inside = is_inside[is_inside]
        return FrameTruth(
            objects, counted=is_inside, point_counts=point_counts, corners=stand.corners
        )

    def _fuse(
        self, frame: Frame, stand: Stand, memory: LinkMemory
    ) -> dict[tuple[str, tuple[int, ...]], Fused]:
        """Fuse a frame by every scheme with every sensor set.

        stand: area and ground of the frame; memory: state of the links, changed in place. Returns
        the fused detections (world frame) by name of the scheme and sensors of the set."""
        comparison = self.comparison
        fused = dict[tuple[str, tuple[int, ...]], Fused]()

        # one view of points and one of images, each shared by all schemes and sets
        @cache
        def view(as_images: bool) -> View:
            """View of the frame, with clouds as images of their sensors or as points."""
            return stand_view(
                frame,
                self.detector,
                stand,
                codec=check_codec(comparison.codec),
                nms_iou=comparison.nms_iou,
                scenes=self.scenes if as_images else None,
                memory=memory,
            )

        for name, scheme in self.schemes.items():
            for sensors, names in self.sets.items():
                # indices in this frame, which may lack some of the sensors; the largest set takes
                # all sensors of the frame if the caller asked for a set of all sensors (None)
                sensor_indices = list(range(len(frame.sensors)))
                if None not in comparison.sensor_sets or len(sensors) < max(map(len, self.sets)):
                    sensor_indices = sorted(select_sensors(frame.sensors, names))
                if scheme is None:
                    result = self._detect_all(frame, stand, sensor_indices)
                else:
                    as_images = self.at_site or sends_images(scheme, comparison.codec)
                    result = scheme.fuse(view(as_images), sensor_indices)
                detections = result.detections
                if not self.at_site:
                    detections = stand.put_back(detections)
                fused[name, sensors] = replace(result, detections=detections)
        return fused

    def _detect_all(self, frame: Frame, stand: Stand, sensors: list[int]) -> Fused:
        """Detect in all points of some sensors together, uncropped and without messages.

        stand: area and ground of the frame, which levels the points; sensors: indices of the
        sensors in the frame. Boxes come back in the frame of the levelled points, without bits."""
        points = stand.lift(frame.seen_by(sensors).points())
        start = perf_counter()
        detections = Detections.empty()
        if len(points):
            detections = detect_on_ground(self.detector, points, stand.area)
        detect_ms = 1e3 * (perf_counter() - start)
        return Fused(detections, bits=np.zeros(0, np.int64), ms=detect_ms)
