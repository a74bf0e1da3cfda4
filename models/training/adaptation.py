"""Adaptation of a network to a place without labels: its detections, joined over time, are the
labels.

Detections of one object in successive frames are joined into a track. A track has one class, the
one with the greatest sum of scores, but no pedestrian is fast, and its boxes belong to that class.
A track that never moves needs higher scores than one that does. Between two detections of a track
the object is added if it cannot have gone far. Of two tracks on one ground the surer one counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from models.detector import relocate
from models.network.candidates import find_rivals
from models.network.voxelnet import VoxelNet
from models.training.loop import Machine, Preset, Progress, train, window
from models.training.packed import PackedFrames
from models.training.samples import SampleRecipe
from models.training.second_stage import compute_recording_ap
from toolkit.arrays import Float, Mask
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects

# between the first two frames of a track
MAX_TRACK_SPEED_M_S = {VEHICLE: 16.0, HEAVY: 14.0, CYCLIST: 9.0, PEDESTRIAN: 3.0}
MAX_TRACK_OFFSET_M = 1.0  # from the expected place of a track to a detection
MAX_TURN_M_S = 2.5  # growth of that offset with time
MAX_PAUSE_S = 1.6  # without a detection, after which a track has ended
MAX_STILL_PAUSE_S = 10.0  # without a detection, after which a track of a still object has ended
# from one detection to the next, for frames in between to be filled
MAX_FILLED_M = {VEHICLE: 0.5, HEAVY: 0.5, CYCLIST: 1.0, PEDESTRIAN: 3.0}
MIN_TRACK_DETECTIONS = 3
MIN_MOVE_M = 1.5  # distance for an object to count as moving
MIN_HEADING_STEP_M = 0.5  # step per frame above which an object heads in its direction of travel
MIN_MOVING_SCORE = 0.5  # mean of the better half of a moving track's scores
MIN_STILL_SCORE = 0.6  # mean of the better half of a still track's scores
ADAPTATION_WINDOW_M = 28.0  # side of the windows
ADAPTING = Preset(
    batch=8,
    learning_rate=3e-4,
    examples=SampleRecipe(subsets=0.3, augmentation="scene", elsewhere=0.3, windows=4),
)


@dataclass
class _Track:
    """Detections of one object."""

    frames: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    boxes: list[Float[np.ndarray, "7"]] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    labels: list[int] = field(default_factory=list)

    @property
    def reach(self) -> float:
        """Distance (m) from the first to the farthest place."""
        places = np.stack(self.boxes)[:, :2]
        return float(np.linalg.norm(places - places[0], axis=1).max())

    @property
    def label(self) -> int:
        """Class with the greatest sum of scores, but a cyclist if too fast for a pedestrian.

        The speed is the quartile of the faster steps.
        """
        steps = np.linalg.norm(np.diff(np.stack(self.boxes)[:, :2], axis=0), axis=1)
        label = int(np.bincount(self.labels, self.scores).argmax())
        fast = np.quantile(steps / np.diff(self.times), 0.75) > MAX_TRACK_SPEED_M_S[PEDESTRIAN]
        return CYCLIST if fast and label == PEDESTRIAN else label

    @property
    def class_boxes(self) -> Float[np.ndarray, "n 7"]:
        """Boxes as the class has them.

        A box detected as another class takes the median size of the boxes detected as this class. A
        moving box heads in its direction of travel, front first.
        """
        boxes = np.stack(self.boxes)
        is_class = np.array(self.labels) == self.label
        if is_class.any():
            size = np.median(boxes[is_class, 3:6], axis=0)
            boxes[~is_class, 2] += (size[2] - boxes[~is_class, 5]) / 2
            boxes[~is_class, 3:6] = size
        x, y = np.gradient(boxes[:, :2], axis=0).T
        heading = np.arctan2(y, x)
        is_moving = np.hypot(x, y) >= MIN_HEADING_STEP_M
        boxes[is_moving & (np.cos(boxes[:, 6] - heading) < 0), 6] += np.pi
        boxes[is_moving & ~is_class, 6] = heading[is_moving & ~is_class]
        return boxes

    @property
    def sure(self) -> bool:
        """True if the track is an object."""
        confidence = np.mean(sorted(self.scores)[len(self.scores) // 2 :])
        min_score = MIN_MOVING_SCORE if self.reach >= MIN_MOVE_M else MIN_STILL_SCORE
        return len(self.frames) >= MIN_TRACK_DETECTIONS and bool(confidence >= min_score)

    def distances(self, detections: Detections, time: float) -> Float[np.ndarray, " n"]:
        """Distances (m) of detections from the track's expected place.

        Infinite for detections that cannot be its next."""
        expected = self.boxes[-1][:2]
        elapsed_s = time - self.times[-1]
        is_new = len(self.frames) == 1
        speed = MAX_TRACK_SPEED_M_S[self.labels[-1]] if is_new else MAX_TURN_M_S
        max_distance = MAX_TRACK_OFFSET_M + speed * elapsed_s
        if elapsed_s > MAX_PAUSE_S:
            is_waiting = (
                len(self.frames) >= MIN_TRACK_DETECTIONS
                and self.reach < MAX_TRACK_OFFSET_M
                and elapsed_s <= MAX_STILL_PAUSE_S
            )
            max_distance = MAX_TRACK_OFFSET_M if is_waiting else -1.0
        elif not is_new:
            earlier = max(-3, -len(self.frames))
            velocity = (expected - self.boxes[earlier][:2]) / (self.times[-1] - self.times[earlier])
            expected = expected + velocity * elapsed_s
        distance = np.linalg.norm(detections.boxes[:, :2] - expected, axis=1)
        is_motor = self.labels[-1] in (VEHICLE, HEAVY)
        is_alike = np.isin(detections.labels, (VEHICLE, HEAVY)) == is_motor
        return np.where(is_alike & (distance <= max_distance), distance, np.inf)


def join_detections(by_frame: Sequence[Detections], times: Sequence[float]) -> list[Objects]:
    """Join detections of frames over time (s, ascending) into objects; their ids are tracks."""
    tracks = _build_tracks(by_frame, times)
    rows: list[list[tuple[np.ndarray, int, int]]] = [[] for _ in by_frame]
    sure_tracks = sorted(
        (track for track in tracks if track.sure),
        key=lambda track: (track.label != HEAVY, -sum(track.scores)),
    )
    for number, track in enumerate(sure_tracks):
        label = track.label
        boxes = track.class_boxes
        for k, (frame, box) in enumerate(zip(track.frames, boxes, strict=True)):
            rows[frame].append((box, label, number))
            if k + 1 == len(track.frames) or track.times[k + 1] - track.times[k] > MAX_PAUSE_S:
                continue
            step = boxes[k + 1][:3] - box[:3]
            if not np.hypot(*step[:2]) <= MAX_FILLED_M[label]:
                continue
            for missing in range(frame + 1, track.frames[k + 1]):
                share = (times[missing] - track.times[k]) / (track.times[k + 1] - track.times[k])
                filled = np.append(box[:3] + share * step, box[3:])
                rows[missing].append((filled, label, number))
    joined = []
    for frame_rows in rows:
        objects = Objects.empty()
        if frame_rows:
            objects = Objects(*map(np.array, zip(*frame_rows, strict=True)))
        joined.append(objects[keep_first(objects.boxes)])
    return joined


def _build_tracks(by_frame: Sequence[Detections], times: Sequence[float]) -> list[_Track]:
    """Assign the detections of each frame to tracks, new ones if no track is near."""
    tracks = list[_Track]()
    for frame, (detections, time) in enumerate(zip(by_frame, times, strict=True)):
        open_tracks = [track for track in tracks if time - track.times[-1] <= MAX_STILL_PAUSE_S]
        rows = [track.distances(detections, time) for track in open_tracks]
        distance = np.array(rows).reshape(len(open_tracks), len(detections))
        cost = np.where(np.isfinite(distance), distance, 1e6)
        owners = {}
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if np.isfinite(distance[row, column]):
                owners[int(column)] = open_tracks[row]
        for k in range(len(detections)):
            track = owners.get(k, _Track())
            if k not in owners:
                tracks.append(track)
            track.frames.append(frame)
            track.times.append(time)
            track.boxes.append(detections.boxes[k])
            track.scores.append(float(detections.scores[k]))
            track.labels.append(int(detections.labels[k]))
    return tracks


def keep_first(boxes: Float[np.ndarray, "n 7"]) -> Mask:
    """Mask of boxes without an earlier kept box on their ground.

    One object may be detected as two classes, for example a cab as a car.
    """
    shared = find_rivals(boxes)
    is_kept = np.ones(len(boxes), bool)
    for row in range(1, len(boxes)):
        is_kept[row] = not (shared[row, :row] & is_kept[:row]).any()
    return is_kept


def train_further(
    network: VoxelNet,
    data: Path,
    out: Path,
    machine: Machine,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> VoxelNet:
    """Train a network further on a packed file, or resume in `out` as `train` does."""
    small = relocate(network, window(network.config.area, ADAPTATION_WINDOW_M), "general")
    settings = replace(ADAPTING, seed=seed)
    trained = train(
        data, small.config, settings, out, start=small, machine=machine, progress=progress
    )
    return relocate(trained, network.config.area, "general").eval()


def adapt_network(
    network: VoxelNet,
    label: Callable[[VoxelNet, bool], Path],
    out: Path,
    machine: Machine,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[VoxelNet, float, float]:
    """Train a network on its detections, and take the mean of the old and the new weights.

    label: packs frames with the labels that a network gives them, held-out frames or the others;
    out, machine, progress: as in `train`, which resumes there. Both networks are evaluated on the
    labels of both, since each detects differently. Returns the new one if it is better, else the
    old one, and the mean AP over classes and IoU of the old and of the returned one."""
    adapted = train_further(
        network, label(network, False), out, machine, seed=seed, progress=progress
    )
    # the mean forgets less, see "Robust fine-tuning", Wortsman et al. 2022
    with torch.no_grad():
        for old, new in zip(
            network.state_dict().values(), adapted.state_dict().values(), strict=True
        ):
            new.copy_((old + new) / 2)
    held_out = [PackedFrames(label(network, True)), PackedFrames(label(adapted, True))]
    old_ap = _mean_ap(network, held_out)
    new_ap = _mean_ap(adapted, held_out)
    return (adapted if new_ap > old_ap else network), old_ap, max(old_ap, new_ap)


def _mean_ap(network: VoxelNet, held_out: Sequence[PackedFrames]) -> float:
    aps: list[float] = []
    for frames in held_out:
        aps += compute_recording_ap(network, frames).values()
    return float(np.mean([ap for ap in aps if np.isfinite(ap)] or [0.0]))
