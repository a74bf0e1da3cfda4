"""Results of one scheme and sensor set in all frames, pooled into figures."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from toolkit.arrays import Float64, Mask
from toolkit.detection.breakdown import FrameTruth, GroupRow, group_rows
from toolkit.detection.figures import ClassFigures, Row
from toolkit.detection.frame_scores import FrameResult, ScoringJob, sends_images
from toolkit.detection.link.load import LinkLoad, link_load
from toolkit.detection.metrics import TRUE_IOU, DetectionScore, evaluate, reliability, second_labels
from toolkit.objects import LABELS, VEHICLE, Detections, label_index
from toolkit.runtime.stage_times import Percentiles, StageTimes


def _find_outside(
    truths: Sequence[FrameTruth], frame_detections: Sequence[Detections]
) -> list[Mask]:
    """Mask of each frame's detections outside the area or the region with complete labels.

    truths, frame_detections: objects and detections of each frame."""
    return [
        ~truth.inside(detections)
        for truth, detections in zip(truths, frame_detections, strict=True)
    ]


class SetResults:
    """Results of one scheme and sensor set in all frames, pooled into figures.

    job: settings of the evaluation; results: result of each frame; scheme: name of the scheme;
    sensors: indices of the sensors. In the attributes, truths, detections, bits (of each sensor)
    and frame_ms (time) are lists by frame; ms is the median of frame_ms, kbit the mean that a
    sensor sends in a frame (1000 bits); outside is None unless detections outside the area are
    treated apart."""

    def __init__(
        self, job: ScoringJob, results: Sequence[FrameResult], scheme: str, sensors: tuple[int, ...]
    ) -> None:
        """Pick the results of one scheme and one set of sensors from all frames.

        scheme: its name; sensors: indices of the sensors in the set."""
        self.job = job
        self.results = results
        self.scheme = scheme
        self.sensors = sensors
        self.truths = [result.truth for result in results]
        fused_frames = [result.fused[scheme, sensors] for result in results]
        self.detections = [fused.detections for fused in fused_frames]
        self.bits = [fused.bits for fused in fused_frames]  # by frame, then by sensor
        self.frame_ms = [fused.ms for fused in fused_frames]
        self.ms = float(np.median(self.frame_ms))
        # mean of the sensors in each frame, then of the frames
        kbits = [bits.mean() / 1000 if len(bits) else 0.0 for bits in self.bits]
        self.kbit = float(np.mean(kbits))
        # masks of detections outside the area, by frame; only the protocol for recorded labels
        # treats these apart
        self.outside: list[Mask] | None = None
        if job.protocol == "measured":
            self.outside = _find_outside(self.truths, self.detections)

    def score_class(self, label: str, thresholds: Sequence[float]) -> dict[float, DetectionScore]:
        """Return the scores of a class in all frames, by IoU threshold.

        label: name of the class; thresholds: IoU thresholds, to which the IoU of a true detection
        (`TRUE_IOU` of the class) is added."""
        return evaluate(
            self.detections,
            [truth.objects for truth in self.truths],
            iou_thresholds=[*thresholds, TRUE_IOU[label_index(label)]],
            metric=self.job.comparison.metric,
            protocol="published" if self.job.protocol == "published" else "exact",
            label=label,
            counted=[truth.counted for truth in self.truths],
            outside=self.outside,
        )

    def make_row(self, label: str, iou: float, score: DetectionScore) -> Row:
        """Return the row of figures of a class at one IoU threshold.

        label: name of the class; iou: the threshold; score: score at this threshold."""
        return Row(
            scheme=self.scheme,
            sensors=self.sensors,
            iou=iou,
            ap=score.ap,
            recall=score.recall,
            precision=score.precision,
            kbit_per_sensor=self.kbit,
            ms_per_frame=self.ms,
            curve=score.curve,
            label=label,
            truths=score.truths,
            false_alarms_per_frame=score.fp / len(self.results),
        )

    def rate_threshold(self, label: str, score: DetectionScore) -> ClassFigures:
        """Return the figures of a class at the detector's score threshold.

        label: name of the class; score: score at the IoU of a true detection (`TRUE_IOU`).
        Detections that give an object a second label count as false alarms here."""
        second_scores = self._second_scores(label)
        frame_count = len(self.results)
        detection_count = score.tp + score.fp + len(second_scores)
        scores = np.append(score.scores, second_scores)
        hits = np.append(score.hits, np.zeros(len(second_scores), bool))
        return ClassFigures(
            scheme=self.scheme,
            sensors=self.sensors,
            label=label,
            iou=TRUE_IOU[label_index(label)],
            frames=frame_count,
            truths=score.truths,
            detections=detection_count,
            recall=score.recall,
            precision=score.tp / detection_count if detection_count else np.nan,
            false_alarms_per_frame=(score.fp + len(second_scores)) / frame_count,
            reliability=reliability(scores, hits),
        )

    def _second_scores(self, label: str) -> Float64[np.ndarray, " n"]:
        """Scores of detections that give an object a second label, in all frames.

        label: name of the class; only vehicles can be second labels, on heavy vehicles."""
        if label != LABELS[VEHICLE]:
            return np.zeros(0)
        scores = [np.zeros(0)]  # so that no frames give an empty array
        for frame_index, truth in enumerate(self.truths):
            detections = self.detections[frame_index]
            is_second = second_labels(
                detections,
                truth.objects,
                metric=self.job.comparison.metric,
                counted=truth.counted,
                outside=None if self.outside is None else self.outside[frame_index],
            )
            scores.append(detections.scores[is_second])
        return np.concatenate(scores)

    def break_down(self, title: str, labels: Iterable[str]) -> list[GroupRow]:
        """Return AP of each class by range, by points and as other data sets count it.

        title: name of scheme and sensor set in the rows; labels: names of the classes."""
        # detections and objects of each frame, ready to match
        frames = [
            truth.judge(detections)
            for truth, detections in zip(self.truths, self.detections, strict=True)
        ]
        rows = list[GroupRow]()
        for label in labels:
            rows += group_rows(frames, label, self.job.comparison.iou_thresholds)
        return [replace(row, scheme=title) for row in rows]

    def find_load(self) -> LinkLoad | None:
        """Return the load of the sensors' messages on a shared link.

        None without a rate of frames, without sensors, or if frames differ in their number of
        sensors."""
        rate = self.job.comparison.rate
        # `self.bits` has for each frame the bits that each sensor sent, in an array
        sensor_counts = {len(bits) for bits in self.bits}
        if rate is None or len(sensor_counts) != 1 or sensor_counts == {0}:
            return None
        return link_load(np.array(self.bits), rate)

    def summarise(self, load: LinkLoad | None) -> dict[str, Any]:
        """Counts, problems and costs of the scheme and sensor set, for text and JSON.

        load: load on a link, None without one. If sensors send images of clouds, `images` counts
        the points of each sensor's clouds, and the points that its images leave out, by kind."""
        # sum of the counters of all frames, beginning with an empty one
        problems = sum((Counter(result.problems) for result in self.results), Counter[str]())
        has_bits = any(len(bits) for bits in self.bits)  # False without messages
        summary: dict[str, Any] = {
            "samples": len(self.results),
            "detections": sum(len(detections.boxes) for detections in self.detections),
            "problems": dict(problems),
            "level_ms": float(np.median([result.level_ms for result in self.results])),
            "detect_ms": self.ms,
            "kbit_per_sensor": self.kbit if has_bits else None,
        }
        if load is not None:
            summary["load"] = vars(load)
        if self.job.comparison.timings:
            summary["timings"] = self._summarise_times()
        scheme = self.job.schemes[self.scheme]
        if not self.job.at_site and sends_images(scheme, self.job.comparison.codec):
            summary["images"] = {
                sensor: {"points": scene.points, **scene.left_out}
                for sensor, scene in self.job.scenes.every.items()
            }
        return summary

    def _summarise_times(self) -> dict[str, Percentiles]:
        """Return median, p95 and p99 (ms) of reading, levelling and fusing, detection included."""
        times = StageTimes()
        for result, fuse_ms in zip(self.results, self.frame_ms, strict=True):
            stages = {"read": result.read_ms, "level": result.level_ms, "fuse": fuse_ms}
            times.add_all(stages)
        return times.summarise()
