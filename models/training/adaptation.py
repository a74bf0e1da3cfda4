"""Adaptation of a network to a place without labels: its own detections, joined over time, are the labels.

Detections of one object in successive frames are joined into a track. An object that was found before and after was
there in between, and it has one class, that of the greatest sum of scores, but no pedestrian is fast. An object that
never moves needs higher scores than one that does. Only the last layer, the head, is trained.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from models.detector import relocate
from models.network.grid import anchors
from models.network.voxelnet import VoxelNet
from models.training.loop import TrainingState, train_step, window
from models.training.losses import quality_loss
from models.training.packed import PackedFrames
from models.training.samples import SampleRecipe, Samples, stack
from models.training.second_stage import average_precision, refit_scores
from toolkit.arrays import Float
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects

FASTEST = {VEHICLE: 16.0, HEAVY: 14.0, CYCLIST: 9.0, PEDESTRIAN: 3.0}  # m/s between the first two frames of a track
APART, TURNED = 1.0, 2.5  # m, and m/s, that a detection may be off the place where its track would go
LONGEST, LONGEST_STILL = 1.6, 10.0  # s without a detection after which a track has ended, and one that stands still
FEWEST_JOINED = 3  # detections of a track
MOVES = 1.5  # m that an object must have moved
SURE_MOVING, SURE_STILL = 0.5, 0.6  # mean score of the better half of a track's detections


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
    def speed(self) -> float:
        """Speed (m/s) of its faster quarter."""
        steps = np.linalg.norm(np.diff(np.stack(self.boxes)[:, :2], axis=0), axis=1)
        return float(np.quantile(steps / np.diff(self.times), 0.75))

    @property
    def sure(self) -> bool:
        """True for an object."""
        confidence = np.mean(sorted(self.scores)[len(self.scores) // 2 :])
        enough = confidence >= (SURE_MOVING if self.reach >= MOVES else SURE_STILL)
        return len(self.frames) >= FEWEST_JOINED and bool(enough)

    def distances(self, found: Detections, time: float) -> Float[np.ndarray, " n"]:
        """Distances (m) of detections from where the track would be; infinite for those that cannot be its next."""
        last, since = self.boxes[-1][:2], time - self.times[-1]
        within = APART + (FASTEST[self.labels[-1]] if len(self.frames) == 1 else TURNED) * since
        if since > LONGEST:
            waits = len(self.frames) >= FEWEST_JOINED and self.reach < APART and since <= LONGEST_STILL
            within = APART if waits else -1.0
        elif len(self.frames) > 1:
            before = max(-3, -len(self.frames))
            last = last + (last - self.boxes[before][:2]) / (self.times[-1] - self.times[before]) * since
        off = np.linalg.norm(found.boxes[:, :2] - last, axis=1)
        alike = np.isin(found.labels, (VEHICLE, HEAVY)) == (self.labels[-1] in (VEHICLE, HEAVY))
        return np.where(alike & (off <= within), off, np.inf)


def join_detections(found: Sequence[Detections], times: Sequence[float]) -> list[Objects]:
    """Join detections of frames over time (s, ascending) into the objects of each; ids are tracks."""
    tracks, frames = list[_Track](), range(len(found))
    for frame, each, time in zip(frames, found, times, strict=True):
        going = [track for track in tracks if time - track.times[-1] <= LONGEST_STILL]
        off = np.array([track.distances(each, time) for track in going]).reshape(len(going), len(each))
        pairs = zip(*linear_sum_assignment(np.where(np.isfinite(off), off, 1e6)), strict=True)
        owner = {int(column): going[row] for row, column in pairs if np.isfinite(off[row, column])}
        for k in range(len(each)):
            track = owner.get(k, _Track())
            if k not in owner:
                tracks.append(track)
            values = frame, time, each.boxes[k], float(each.scores[k]), int(each.labels[k])
            for column, value in zip(vars(track).values(), values, strict=True):
                column.append(value)
    rows: list[list[tuple[np.ndarray, int, int]]] = [[] for _ in frames]
    for number, track in enumerate(each for each in tracks if each.sure):
        label = int(np.bincount(track.labels, track.scores).argmax())
        label = CYCLIST if label == PEDESTRIAN and track.speed > FASTEST[PEDESTRIAN] else label
        when, boxes = np.array([times[k] for k in range(track.frames[0], track.frames[-1] + 1)]), np.stack(track.boxes)
        nearest = np.abs(when[:, None] - track.times).argmin(axis=1)
        there = boxes[nearest]
        there[:, :3] = np.column_stack([np.interp(when, track.times, boxes[:, axis]) for axis in range(3)])
        for frame, box in enumerate(there, track.frames[0]):
            rows[frame].append((box, label, number))
    return [Objects(*map(np.array, zip(*each, strict=True))) if each else Objects.empty() for each in rows]


HEAD_BATCH, HEAD_RATE = 4, 1e-3
RECIPE = SampleRecipe(subsets=0.3, augmentation="scene", elsewhere=0.3)


def train_head(network: VoxelNet, frames: PackedFrames, steps: int, *, seed: int = 0) -> VoxelNet:
    """Return the network with its head trained on packed frames."""
    made = relocate(copy.deepcopy(network), window(network.config.area), "general").eval()
    made.requires_grad_(False)
    trained = [each.requires_grad_(True) for name, each in made.named_parameters() if name.startswith("head.")]
    optimiser = torch.optim.AdamW(trained, HEAD_RATE, weight_decay=0.0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, HEAD_RATE, total_steps=max(steps, 10), pct_start=0.2)
    run, samples = TrainingState(made, optimiser, schedule), Samples(frames, made.config, RECIPE, seed)
    loss, anchor = partial(quality_loss, classes=made.config.anchor_labels), anchors(made.config)
    rng = np.random.default_rng(seed)
    for step in range(steps):
        batch = stack([samples[step, int(k)] for k in rng.integers(len(samples), size=HEAD_BATCH)])
        train_step(run, batch, loss, anchor, False)
        schedule.step()
    return relocate(made.requires_grad_(True), network.config.area, "general").eval()


HEAD_STEPS = 200


def adapt_network(
    network: VoxelNet, label: Callable[[VoxelNet, bool], PackedFrames], *, steps: int = HEAD_STEPS, seed: int = 0
) -> tuple[VoxelNet, float, float]:
    """Train the head on what the network itself labels, and refit its scores and thresholds on frames held out.

    label: packs frames with the labels that a network gives them, those held out or the others. Old and new network are
    judged on the labels of both, since each finds its own. Returns the new one if it is better, else the old one as it
    was, and the mean AP over classes and IoU thresholds of the old and of the returned one.
    """
    choices = network, train_head(network, label(network, False), steps, seed=seed)
    held_out = [label(each, True) for each in choices]
    judged = ([ap for of in held_out for ap in average_precision(each, of).values()] for each in choices)
    before, after = (float(np.nanmean(each)) for each in judged)
    if after <= before:
        return network, before, before
    return refit_scores(choices[1], held_out[1], seed=seed), before, after
