"""Adaptation of a network to a place without labels: its own detections, joined over time, are the
labels.

Detections of one object in successive frames are joined into a track. It has one class, that of the
greatest sum of scores, but no pedestrian is fast, and its boxes are of that class. One that never
moves needs higher scores than one that does. Between two detections of a track the object is added
where it cannot have gone far. Of two tracks on one ground the surer one counts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from models.detector import relocate
from models.network.candidates import share_ground
from models.network.voxelnet import VoxelNet
from models.training.loop import Machine, Preset, Progress, train, window
from models.training.packed import PackedFrames
from models.training.samples import SampleRecipe
from models.training.second_stage import average_precision
from toolkit.arrays import Float, Mask
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects

# m/s between the first two frames of a track
FASTEST = {VEHICLE: 16.0, HEAVY: 14.0, CYCLIST: 9.0, PEDESTRIAN: 3.0}
# m, and m/s, that a detection may be off the place where its track would go
APART = 1.0
TURNED = 2.5
# s without a detection after which a track has ended, and one that stands still
LONGEST = 1.6
LONGEST_STILL = 10.0
# m from one detection to the next
BETWEEN = {VEHICLE: 0.5, HEAVY: 0.5, CYCLIST: 1.0, PEDESTRIAN: 3.0}
FEWEST_JOINED = 3  # detections of a track
MOVES = 1.5  # m that an object must have moved
HEADS = 0.5  # m from frame to frame above which an object heads where it goes
# mean score of the better half of a track's detections
SURE_MOVING = 0.5
SURE_STILL = 0.6


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
        """Class of the greatest sum of scores, but a cyclist if its faster quarter is too fast for
        a pedestrian."""
        steps = np.linalg.norm(np.diff(np.stack(self.boxes)[:, :2], axis=0), axis=1)
        label = int(np.bincount(self.labels, self.scores).argmax())
        fast = np.quantile(steps / np.diff(self.times), 0.75) > FASTEST[PEDESTRIAN]
        return CYCLIST if fast and label == PEDESTRIAN else label

    @property
    def class_boxes(self) -> Float[np.ndarray, "n 7"]:
        """Boxes as the class has them: one found as another class takes the median size of those
        found as its own, and what moves heads, front first, where it goes."""
        boxes = np.stack(self.boxes)
        own = np.array(self.labels) == self.label
        if own.any():
            size = np.median(boxes[own, 3:6], axis=0)
            boxes[~own, 2] += (size[2] - boxes[~own, 5]) / 2
            boxes[~own, 3:6] = size
        x, y = np.gradient(boxes[:, :2], axis=0).T
        way = np.arctan2(y, x)
        goes = np.hypot(x, y) >= HEADS
        boxes[goes & (np.cos(boxes[:, 6] - way) < 0), 6] += np.pi
        boxes[goes & ~own, 6] = way[goes & ~own]
        return boxes

    @property
    def sure(self) -> bool:
        """True for an object."""
        confidence = np.mean(sorted(self.scores)[len(self.scores) // 2 :])
        least = SURE_MOVING if self.reach >= MOVES else SURE_STILL
        return len(self.frames) >= FEWEST_JOINED and bool(confidence >= least)

    def distances(self, found: Detections, time: float) -> Float[np.ndarray, " n"]:
        """Distances (m) of detections from where the track would be; infinite for those that cannot
        be its next."""
        last = self.boxes[-1][:2]
        since = time - self.times[-1]
        within = APART + (FASTEST[self.labels[-1]] if len(self.frames) == 1 else TURNED) * since
        if since > LONGEST:
            waits = (
                len(self.frames) >= FEWEST_JOINED and self.reach < APART and since <= LONGEST_STILL
            )
            within = APART if waits else -1.0
        elif len(self.frames) > 1:
            before = max(-3, -len(self.frames))
            last = (
                last
                + (last - self.boxes[before][:2]) / (self.times[-1] - self.times[before]) * since
            )
        off = np.linalg.norm(found.boxes[:, :2] - last, axis=1)
        alike = np.isin(found.labels, (VEHICLE, HEAVY)) == (self.labels[-1] in (VEHICLE, HEAVY))
        return np.where(alike & (off <= within), off, np.inf)


def join_detections(found: Sequence[Detections], times: Sequence[float]) -> list[Objects]:
    """Join detections of frames over time (s, ascending) into the objects of each; ids are
    tracks."""
    tracks = list[_Track]()
    for frame, (each, time) in enumerate(zip(found, times, strict=True)):
        going = [track for track in tracks if time - track.times[-1] <= LONGEST_STILL]
        off = np.array([track.distances(each, time) for track in going]).reshape(
            len(going), len(each)
        )
        pairs = zip(*linear_sum_assignment(np.where(np.isfinite(off), off, 1e6)), strict=True)
        owner = {int(column): going[row] for row, column in pairs if np.isfinite(off[row, column])}
        for k in range(len(each)):
            track = owner.get(k, _Track())
            if k not in owner:
                tracks.append(track)
            values = frame, time, each.boxes[k], float(each.scores[k]), int(each.labels[k])
            for column, value in zip(vars(track).values(), values, strict=True):
                column.append(value)
    rows: list[list[tuple[np.ndarray, int, int]]] = [[] for _ in found]
    sure = sorted(
        (each for each in tracks if each.sure),
        key=lambda track: (track.label != HEAVY, -sum(track.scores)),
    )
    for number, track in enumerate(sure):
        label = track.label
        boxes = track.class_boxes
        for k, (frame, box) in enumerate(zip(track.frames, boxes, strict=True)):
            rows[frame].append((box, label, number))
            if k + 1 == len(track.frames) or track.times[k + 1] - track.times[k] > LONGEST:
                continue
            ahead = boxes[k + 1][:3] - box[:3]
            for between in range(
                frame + 1, track.frames[k + 1] if np.hypot(*ahead[:2]) <= BETWEEN[label] else 0
            ):
                share = (times[between] - track.times[k]) / (track.times[k + 1] - track.times[k])
                rows[between].append((np.append(box[:3] + share * ahead, box[3:]), label, number))
    joined = [
        Objects(*map(np.array, zip(*each, strict=True))) if each else Objects.empty()
        for each in rows
    ]
    return [each[first_claims(each.boxes)] for each in joined]


def first_claims(boxes: Float[np.ndarray, "n 7"]) -> Mask:
    """Mask of boxes on whose ground none before them stands: one object may be found as two
    classes, a cab as a car."""
    shared = share_ground(boxes)
    kept = np.ones(len(boxes), bool)
    for row in range(1, len(boxes)):
        kept[row] = not (shared[row, :row] & kept[:row]).any()
    return kept


SIDE = 28.0  # m, of the windows
ADAPTING = Preset(
    batch=8,
    learning_rate=3e-4,
    examples=SampleRecipe(subsets=0.3, augmentation="scene", elsewhere=0.3, windows=4),
)


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
    small = relocate(network, window(network.config.area, SIDE), "general")
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
    """Train a network on what it labels itself, and take the mean of the old weights and the new.

    label: packs frames with the labels that a network gives them, those held out or the others;
    out, machine, progress: as in `train`, which resumes there. Both networks are judged on the
    labels of both, since each finds its own. Returns the new one if it is better, else the old one,
    and the mean AP over classes and IoU of the old and of the returned one."""
    adapted = train_further(
        network, label(network, False), out, machine, seed=seed, progress=progress
    )
    with (
        torch.no_grad()
    ):  # the mean keeps more of what was known, see "Robust fine-tuning", Wortsman et al. 2022
        for old, new in zip(
            network.state_dict().values(), adapted.state_dict().values(), strict=True
        ):
            new.copy_((old + new) / 2)
    held_out = [PackedFrames(label(each, True)) for each in (network, adapted)]
    judged = [
        [ap for of in held_out for ap in average_precision(each, of).values()]
        for each in (network, adapted)
    ]
    before, after = (
        float(np.mean([ap for ap in each if np.isfinite(ap)] or [0.0])) for each in judged
    )
    return (adapted if after > before else network), before, max(before, after)
