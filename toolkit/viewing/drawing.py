"""Drawing of frames, on level ground if wanted."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import BoxRows, Float64
from toolkit.calibration.place import Place, Stand
from toolkit.detection.detect import FrameDetections, detect_frames
from toolkit.frame import Frame, OtherObjects, SensorCloud
from toolkit.objects import LABELS, Detections, Detector, label_index
from toolkit.plots.line_style import Outcome
from toolkit.tracking.tracks import Tracks
from toolkit.viewing.box_lines import Segments
from toolkit.viewing.drawn import OTHERS, DrawnCloud, DrawnSample, Tag, sort_kinds
from toolkit.viewing.outcomes import MARKED, Marked, sort_outcomes
from toolkit.viewing.track_overlay import TrackOverlay, trail_segments

GROUND_PERCENTILE = 5.0  # percentile of heights that is the ground of a cloud, if not levelled


@dataclass(frozen=True, eq=False)
class _Lift:
    """Move points and boxes from the world to a drawing, on level ground if that was found.

    stand: ground and area of the frame; origin: x, y, z (m, world) of the point that is the origin
    of the drawing."""

    stand: Stand
    origin: Float64[np.ndarray, "3"]

    def move_points(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Return points (m, world) counted from the drawing's origin.

        If ground was found (`Stand.ground`), they are levelled by it."""
        # ground is known relative to the middle of the area, not to the origin
        middle = np.array([*self.stand.middle, 0.0])
        centred_points = points - middle
        if self.stand.ground is not None and len(centred_points):
            centred_points = self.stand.ground.points(centred_points)
        return centred_points + (middle - self.origin)

    def move_boxes(self, boxes: BoxRows) -> BoxRows:
        """Return boxes (m, rad, world) counted from the drawing's origin.

        If ground was found (`Stand.ground`), they are levelled by it. Columns are x, y, z, length,
        width, height and yaw."""
        # As in `move_points`: ground is known relative to the middle of the area. Boxes are shifted
        # in x, y and z; sizes and yaw stay.
        middle = np.array([*self.stand.middle, 0.0])
        centred_boxes = boxes - np.array([*middle, 0, 0, 0, 0])
        if self.stand.ground is not None and len(centred_boxes):
            centred_boxes = self.stand.ground.boxes(centred_boxes)
        return centred_boxes + np.array([*(middle - self.origin), 0, 0, 0, 0])

    def draw_cloud(self, cloud: SensorCloud) -> DrawnCloud:
        """Return the points and the position of a sensor in the drawing."""
        points = self.move_points(cloud.in_world()).astype(np.float32)
        world_position = cloud.world_SE3_sensor[:3, 3]
        position = self.move_points(world_position[None])[0]  # as the only one of its array
        return DrawnCloud(
            name=cloud.name,
            points=points,
            place=position,
            time=cloud.time,
            intensity=cloud.intensity,
        )

    def draw_tags(self, outcome: Outcome, kind: str, rows: Detections) -> list[Tag]:
        """Return a tag for each box of one outcome and class, above the middle of its roof.

        kind: name of the class; rows: boxes (world) and scores, which are ignored for missed
        labels, and numbers of tracks if they are `Tracks`."""
        tags = []
        boxes = self.move_boxes(rows.boxes)
        centres = boxes[:, :3].tolist()
        heights = boxes[:, 5].tolist()
        names = [kind] * len(rows)
        if isinstance(rows, Tracks):
            names = [f"{kind} {number}" for number in rows.ids.tolist()]
        scores = rows.scores
        for (x, y, z), height, name, score in zip(centres, heights, names, scores, strict=True):
            text = f"{kind} missed" if outcome == "missed" else f"{name} {score:.2f}"
            if outcome == "false alarm":
                text += " false"
            tags.append(Tag(kind, outcome, text, place=(x, y, z + height / 2)))
        return tags


@dataclass(frozen=True)
class Drawing:
    """Options for drawing frames.

    Attributes:
        detector: detector whose boxes are drawn too, None for labels only.
        place: area and ground for the detector.
        least_score: score below which no detection is drawn.
        classes: names of the classes that are drawn, all if None.
        sensors: indices or names of the sensors whose clouds are drawn and used, all if None.
        tracks: tracks that are drawn in place of detections, None without any.
    """

    detector: Detector | None = None
    place: Place = Place("none")
    least_score: float = 0.0
    classes: Sequence[str] | None = None
    sensors: Sequence[int | str] | None = None
    tracks: TrackOverlay | None = None

    @property
    def has_detections(self) -> bool:
        """True if detections or tracks are drawn."""
        return self.detector is not None or self.tracks is not None

    def find_origin(self, sample: Frame) -> Float64[np.ndarray, "3"]:
        """Origin (m, world) for a recording that begins with this frame.

        It is the middle of the sensors, at the height of their ground, a low percentile of the
        points' heights. If the ground is levelled, it has the height 0 already."""
        heights = sample.points()[:, 2]
        ground_height = 0.0
        if self.place.level == "none" and len(heights):
            ground_height = np.round(np.percentile(heights, GROUND_PERCENTILE))
        return np.array([*self.place.find_middle(sample), ground_height], np.float64)

    def draw(self, sample: Frame, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
        """Return clouds, boxes, outcomes and tags of a frame, counted from an origin.

        origin: x, y, z (m, world), the same for all frames of a recording. Raises ValueError for an
        unknown levelling."""
        detected = self._detect(sample)
        frame = detected.frame
        lift = _Lift(detected.stand, origin)
        truth = sort_kinds(lift.move_boxes(frame.objects.boxes), frame.objects.labels)
        if len(frame.others.boxes):
            truth[OTHERS] = lift.move_boxes(frame.others.boxes)
        detections = detected.detections
        # boxes in the world, by part of the scene (such as "hits") and name of the class
        world_outcomes = sort_outcomes(detected) if self.has_detections else {}
        outcomes: dict[Marked, dict[str, np.ndarray]] = {}  # the same boxes in the drawing
        tags: list[Tag] = []
        for part, rows_by_kind in world_outcomes.items():
            outcomes[part] = {}
            for kind, kind_rows in rows_by_kind.items():
                outcomes[part][kind] = lift.move_boxes(kind_rows.boxes)
                tags += lift.draw_tags(MARKED[part], kind, kind_rows)
        if not any(world_outcomes.values()):  # without outcomes, detections have their own tags
            for label in set(detections.labels):
                class_rows = detections[detections.labels == label]
                tags += lift.draw_tags("detection", LABELS[label], class_rows)
        return DrawnSample(
            name=frame.name,
            time=frame.time,
            clouds=tuple(lift.draw_cloud(cloud) for cloud in frame.clouds),
            truth=truth,
            detections=sort_kinds(lift.move_boxes(detections.boxes), detections.labels),
            warning=detected.stand.warning,
            outcomes=outcomes,
            tags=tuple(tags),
            trails=self._draw_trails(frame, detections, lift),
        )

    def _draw_trails(
        self, frame: Frame, detections: Detections, lift: _Lift
    ) -> dict[str, Segments]:
        """Trails of the tracks of a frame, as lines (start and end, m) by name of the class.

        They are empty unless the detections are tracks. lift: moves boxes to where they are
        drawn."""
        if self.tracks is None or not isinstance(detections, Tracks):
            return {}
        trails_by_kind: dict[str, list[Segments]] = {}
        for name, boxes in self.tracks.trace(frame, detections).items():
            kind = name.partition(" ")[0]  # from a name such as "vehicle 7"
            trails_by_kind.setdefault(kind, []).append(trail_segments(lift.move_boxes(boxes)))
        return {kind: np.concatenate(trails) for kind, trails in trails_by_kind.items()}

    def _detect(self, sample: Frame) -> FrameDetections:
        """Frame and detections, restricted to the sensors, classes and scores that are drawn.

        Tracks take the place of detections. Without a detector or tracks there are none."""
        if self.sensors is not None:
            sample = sample.seen_by(self.sensors)
        detector = self.detector or (lambda points: Detections.empty())
        (detected,) = detect_frames([sample], detector, self.place)
        if self.tracks is not None:
            detected = replace(detected, detections=self.tracks.find(sample))
        is_sure = detected.detections.scores >= self.least_score
        detections = detected.detections[is_sure]
        if self.classes is None:
            return replace(detected, detections=detections)
        labels = [label_index(name) for name in self.classes]
        frame = detected.frame.select_objects(np.isin(detected.frame.objects.labels, labels))
        return replace(
            detected,
            frame=replace(frame, others=OtherObjects()),  # objects of classes other than ours
            detections=detections[np.isin(detections.labels, labels)],
        )

    def draw_all(
        self, samples: Iterable[Frame], progress: Callable[[int], None] = lambda done: None
    ) -> list[DrawnSample]:
        """Draw frames in order, all from the origin of the first.

        progress: called with the number of frames done."""
        drawn_samples: list[DrawnSample] = []
        origin: np.ndarray | None = None
        for sample in samples:
            if origin is None:
                origin = self.find_origin(sample)
            drawn_samples.append(self.draw(sample, origin))
            progress(len(drawn_samples))
        return drawn_samples
