"""Drawing of frames, on level ground if wanted."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.place import Place
from toolkit.detection.detect import detect_frames
from toolkit.frame import Frame, OtherObjects
from toolkit.objects import LABELS, Detections, Detector, label_index
from toolkit.plots.canvas import Outcome
from toolkit.viewing.drawn import OTHERS, DrawnCloud, DrawnSample, Tag, sort_kinds
from toolkit.viewing.outcomes import MARKED, Marked, sort_outcomes

GROUND_PERCENTILE = (
    5.0  # percentile of heights where the ground of a cloud that is not levelled is taken to be
)


def _list_tags(outcome: Outcome, kind: str, boxes: np.ndarray, rows: Detections) -> list[Tag]:
    tags = []
    for (x, y, z, _, _, height, _), score in zip(boxes.tolist(), rows.scores, strict=True):
        text = f"{kind} missed" if outcome == "missed" else f"{kind} {score:.2f}"
        tags.append(
            Tag(
                kind,
                outcome,
                text + (" false" if outcome == "false alarm" else ""),
                (x, y, z + height / 2),
            )
        )
    return tags


@dataclass(frozen=True)
class Drawing:
    """Options for drawing frames. detector: its boxes are drawn too; place: where it looks, and on
    what ground; least_score: of the boxes that are drawn; classes, sensors: only boxes of these,
    and only the clouds of these, all when None."""

    detector: Detector | None = None
    place: Place = Place("none")
    least_score: float = 0.0
    classes: Sequence[str] | None = None
    sensors: Sequence[int | str] | None = None

    def origin(self, sample: Frame) -> Float64[np.ndarray, "3"]:
        """Origin (m) for a recording that begins with this frame. It is in the world frame: the
        middle of the sensors, and their ground if that stays as it is."""
        points = sample.points()
        stays = self.place.level == "none" and len(points) > 0
        low = np.round(np.percentile(points[:, 2], GROUND_PERCENTILE)) if stays else 0.0
        return np.array([*self.place.find_middle(sample), low], np.float64)

    def draw(self, sample: Frame, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
        """Draw a frame. Raises ValueError for an unknown levelling."""
        sample = sample if self.sensors is None else sample.seen_by(self.sensors)
        detector = self.detector or (lambda points: Detections.empty())
        (detected,) = detect_frames([sample], detector, self.place)
        detected = replace(
            detected, detections=detected.detections[detected.detections.scores >= self.least_score]
        )
        if self.classes is not None:
            wanted_labels = [label_index(label) for label in self.classes]
            frame = replace(
                detected.frame.of(np.isin(detected.frame.objects.labels, wanted_labels)),
                others=OtherObjects(),
            )
            class_detections = detected.detections[
                np.isin(detected.detections.labels, wanted_labels)
            ]
            detected = replace(detected, frame=frame, detections=class_detections)
        sample = detected.frame
        found_detections = detected.detections
        ground = detected.stand.ground
        to_middle = np.array([*detected.stand.middle, 0.0])
        back = to_middle - origin

        def placed(points: np.ndarray) -> np.ndarray:
            near = points - to_middle
            return (near if ground is None or not len(near) else ground.points(near)) + back

        def boxes(rows: np.ndarray) -> np.ndarray:
            near = rows - np.array([*to_middle, 0, 0, 0, 0])
            return (near if ground is None or not len(near) else ground.boxes(near)) + np.array(
                [*back, 0, 0, 0, 0]
            )

        clouds = []
        for cloud in sample.clouds:
            points = placed(cloud.in_world()).astype(np.float32)
            position = placed(cloud.world_SE3_sensor[None, :3, 3])[0]
            clouds.append(DrawnCloud(cloud.name, points, position, cloud.time, cloud.intensity))
        truth = sort_kinds(boxes(sample.objects.boxes), sample.objects.labels)
        truth |= {OTHERS: boxes(sample.others.boxes)} if len(sample.others.boxes) else {}
        detections = sort_kinds(boxes(found_detections.boxes), found_detections.labels)
        by_outcome = {} if self.detector is None else sort_outcomes(detected)
        outcomes: dict[Marked, dict[str, np.ndarray]] = {}
        for name, by_kind in by_outcome.items():
            outcomes[name] = {kind: boxes(rows.boxes) for kind, rows in by_kind.items()}
        marked = [
            (MARKED[name], kind, rows)
            for name, by in by_outcome.items()
            for kind, rows in by.items()
        ]
        marked = marked or [
            ("detection", LABELS[label], found_detections[found_detections.labels == label])
            for label in set(found_detections.labels)
        ]
        tags = tuple(
            tag
            for outcome, kind, rows in marked
            for tag in _list_tags(outcome, kind, boxes(rows.boxes), rows)
        )
        drawn = DrawnSample(sample.name, sample.time, tuple(clouds), truth, detections)
        return replace(drawn, warning=detected.stand.warning, outcomes=outcomes, tags=tags)

    def draw_all(
        self, samples: Iterable[Frame], progress: Callable[[int], None] = lambda done: None
    ) -> list[DrawnSample]:
        """Draw frames from the origin of the first."""
        drawn: list[DrawnSample] = []
        origin: np.ndarray | None = None
        for sample in samples:
            origin = self.origin(sample) if origin is None else origin
            drawn.append(self.draw(sample, origin))
            progress(len(drawn))
        return drawn
