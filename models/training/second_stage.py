"""Second stage of a network: measured AP, calibrated scores, measured faces, more classes.

Calibration turns scores into shares of true detections and finds thresholds above which nearly all
are true. Faces are fitted to boxes as detected and to boxes displaced at random, by more than the
detector's errors on vehicles it knows. So the points must count, not the first stage's sizes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize

from models.config import FITTED, VoxelNetConfig
from models.detector import VoxelNetDetector, relocate
from models.network.candidates import logit, rescore, sigmoid, strongest_rivals
from models.network.faces import SORTS, FaceNetworks, face_features, face_offsets
from models.network.voxelnet import VoxelNet
from models.training.packed import Area, PackedFrames, Rig
from models.training.samples import read_points
from toolkit.arrays import BoxRows, Float, Float32, Int64, Mask, Rng
from toolkit.boxes import count_points, iou_bev
from toolkit.detection.background import SWEEPS, Background, KnownBackground
from toolkit.detection.metrics import TRUE_IOU, evaluate, matches
from toolkit.geometry import level_rows
from toolkit.objects import HEAVY, LABELS, VEHICLE, Detections, Detector, Objects, label_index
from toolkit.points import has_centre_inside

_Scores = Float[np.ndarray, " n"]
_Hits = Int64[np.ndarray, " n"]

IOU_THRESHOLDS = (0.7, 0.8, 0.9)
AREAS_KEPT = 4
# of cyclists, pedestrians and heavy vehicles, which are small, or vary more
OTHER_THRESHOLDS = (0.25, 0.5, 0.7)


def detector_by_area(
    network: VoxelNet, device: str | torch.device = "cpu", score_threshold: float | None = 0.05
) -> Callable[[Area], Detector]:
    """Return a function that makes the detector of an area."""

    @lru_cache(
        maxsize=AREAS_KEPT
    )  # each has its anchors on the whole area, and a packed file may show thousands
    def at_work(area: Area) -> Detector:
        return VoxelNetDetector(
            relocate(network, area, "general"), device=device, score_threshold=score_threshold
        )

    return at_work


def detect_frames(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    subsets: float = 0.0,
    errors: float = 0.0,
    known: bool = False,
) -> list[tuple[Detections, Objects, Mask]]:
    """Detect in the first `count` frames (None: all) by early fusion. Returns detections, truth and
    a mask of objects centred in the frame's area. subsets, errors: see `read_points`; known: leave
    out what belongs to the empty site."""
    training = network.training
    detector_in = detector_by_area(network, device, LOWEST)
    results = []
    background = lru_cache(maxsize=AREAS_KEPT)(_background)
    for k in range(min(len(frames), count or len(frames))):
        area = frames.rig(k).area
        points = read_points(
            frames, k, np.random.default_rng([seed, k]), subsets=subsets, errors=errors
        )
        truth = frames.level_objects(k)
        detector = detector_in(area)
        if known:
            detector = KnownBackground(detector, background(frames.rig(k)))
        results.append((detector(points), truth, has_centre_inside(truth.boxes, np.array(area))))
    network.train(training)
    return results


def _background(rig: Rig) -> Background:
    """Learn the empty site from noisy sweeps of a rig."""
    rng = np.random.default_rng(0)
    none = np.zeros(0, np.uint32)
    sweeps = [
        rig.measure(s, none, none, rng)[0] for _ in range(SWEEPS) for s in range(len(rig.sensors))
    ]
    return Background.learn(np.concatenate([level_rows(points, rig.slope) for points in sweeps]))


def average_precision(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> dict[str, float]:
    """AP3D of early fusion over the first `count` frames (None: all), in the protocol "exact".

    Names are "AP@0.7" and so on for vehicles, "pedestrian AP@0.5" and so on for others; classes
    without objects are left out. seed: of the sensors' noise."""
    judged = detect_frames(network, frames, count=count, seed=seed, device=device)
    detections, truths, counted = zip(*judged, strict=True)
    figures: dict[str, float] = {}
    for label in network.config.labels:
        vehicle = label == LABELS[VEHICLE]
        thresholds, prefix = (IOU_THRESHOLDS, "") if vehicle else (OTHER_THRESHOLDS, f"{label} ")
        at = evaluate(detections, truths, iou_thresholds=thresholds, counted=counted, label=label)
        figures |= {
            f"{prefix}AP@{at_iou:g}": each.ap
            for at_iou, each in at.items()
            if each.truths or vehicle
        }
    return figures


_MAPS = tuple(f"head.{name}." for name in ("classes", "residuals", "direction", "quality"))


def widen(network: VoxelNet, config: VoxelNetConfig) -> VoxelNet:
    """Return a network widened to the classes of `config`. Weights of shared classes are taken
    over, with their anchors; anchors of new classes start at random, always the same. A network of
    the same classes without a second stage is returned unchanged."""
    known = network.config
    if known.labels == config.labels and not known.faces:
        return network
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        bare: dict[str, Any] = dict.fromkeys(("faces", *FITTED), ())
        wider = VoxelNet(replace(known, labels=config.labels, kinds=config.kinds, **bare))
    state = wider.state_dict()
    for name, old in network.state_dict().items():
        if name.startswith(
            _MAPS
        ):  # channels of shared anchors come from the old network, others stay as they are
            channels = len(state[name]) // len(wider.config.anchor_labels)
            for label in set(config.labels) & set(known.labels):
                rows = _channels(wider.config, label, channels)
                places = _channels(known, label, channels)
                if len(rows) == len(places):
                    state[name][rows] = old[places]
        elif name in state:
            state[name] = old
    wider.load_state_dict(state)
    return wider


def rebuild(network: VoxelNet, **changes: Any) -> VoxelNet:
    """Same weights, other configuration; new parts start at random."""
    other = VoxelNet(replace(network.config, **changes))
    state = other.state_dict()
    state |= {name: tensor for name, tensor in network.state_dict().items() if name in state}
    other.load_state_dict(state)
    return other.train(network.training)


def _channels(config: VoxelNetConfig, label: str, each: int) -> list[int]:
    """Channels of a class's anchors, `each` per anchor."""
    anchors = [
        anchor for anchor, row in enumerate(config.anchor_labels) if config.labels[row] == label
    ]
    return [anchor * each + channel for anchor in anchors for channel in range(each)]


PRECISION = 0.97  # of the detections above the chosen threshold
MOST_LOST = 0.05  # share of true detections that a threshold may lose at any precision
FEWEST = 30  # detections; a class with fewer keeps its scores
LOWEST = 0.05  # least score of the detections used
LEAST_SURE = 0.2  # calibrated score, the lowest default threshold
# outcomes of detections
TRUE = 1
FALSE = 0
UNCOUNTED = -1
# shares of the frames seen by some of the sensors, and by sensors with errors
_SUBSETS = 0.3
_ERRORS = 0.3
_RIDGE = 1.0  # pulls the slope to 1 and the intercept to 0
_LEAST_SLOPE = 0.05


def platt(
    scores: _Scores, hits: Mask, rivals: Float[np.ndarray, "n L"] | None = None
) -> tuple[float, ...]:
    """Fit slope, intercept and the weights (at least 0) of rivals' scores to hits (Platt 1999).
    They make sigmoid(slope · logit(score) + intercept - Σ weight · rival) the likeliest share of
    true detections."""
    rivals = np.zeros((len(scores), 0)) if rivals is None else rivals
    rows = np.column_stack([logit(scores), np.ones(len(scores)), -rivals])
    wanted = np.eye(1, rows.shape[1])[0]

    def lost(answer: np.ndarray) -> tuple[float, np.ndarray]:
        p = rows @ answer
        off = answer - wanted
        loss = float(np.logaddexp(0.0, p).sum() - p[hits].sum() + _RIDGE / 2 * off @ off)
        return loss, rows.T @ (sigmoid(p) - hits) + _RIDGE * off

    bounds = [(_LEAST_SLOPE, None), (None, None), *((0.0, None) for _ in rivals.T)]
    found = minimize(
        lost,
        wanted,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-7},
    )
    return tuple(float(each) for each in found.x)


def lowest_threshold(scores: _Scores, hits: Mask, precision: float) -> float:
    """Lowest score above which a share `precision` of detections is true, 0 if that holds for all
    of them.

    If it holds for no `FEWEST` or more, the score above which that many are left; but never a score
    that loses more than `MOST_LOST` of the true detections."""
    order = np.argsort(-scores, kind="stable")
    share = np.cumsum(hits[order]) / np.arange(1, len(order) + 1)
    good = np.flatnonzero((share >= precision) & (np.arange(1, len(order) + 1) >= FEWEST))
    first_out = good[-1] + 1 if len(good) else min(FEWEST, len(order))
    least = float(scores[order][first_out]) if first_out < len(order) else 0.0
    true = np.sort(scores[hits])
    return (
        min(least, float(np.nextafter(true[int(MOST_LOST * len(true))], 0.0)))
        if len(true)
        else least
    )


def fit_calibration(
    network: VoxelNet, frames: PackedFrames, *, count: int | None = None, seed: int = 0
) -> VoxelNet:
    """Return the network with calibration, rivalry and a threshold per class. Each threshold is the
    lowest above which `PRECISION` of the detections are true, over the first `count` frames (None:
    all) of a file that training did not use, some of them seen by some of the sensors or by sensors
    with errors."""
    bare = rebuild(network, score_threshold=LOWEST, **dict.fromkeys(FITTED, ()))
    labels = bare.config.labels
    judged = _judge(bare, frames, count, seed)
    hits = np.concatenate([np.zeros(0, int), *(hits for _, hits in judged)])
    before = Detections.merge(found for found, _ in judged)
    rows_of = [(hits != UNCOUNTED) & (before.labels == LABELS.index(label)) for label in labels]
    pairs = [
        platt(before.scores[own], hits[own] == TRUE) if own.sum() >= FEWEST else (1.0, 0.0)
        for own in rows_of
    ]
    by_label = dict(zip(map(LABELS.index, labels), pairs, strict=True))
    sure = []
    for found, of_frame in judged:
        slope, shift = np.array([by_label[int(label)] for label in found.labels]).reshape(-1, 2).T
        sure.append(
            (
                Detections(found.boxes, sigmoid(slope * logit(found.scores) + shift), found.labels),
                of_frame,
            )
        )
    rivalry, thresholds = _fit_rivals(sure, bare.config)
    done = rebuild(bare, calibration=tuple(pairs), rivalry=rivalry, thresholds=thresholds)
    if any(map(frames.is_recorded, range(len(frames)))):
        return done
    known, known_thresholds = _fit_rivals(
        _judge(done, frames, count, seed, known=True), bare.config
    )
    return rebuild(done, known=known, known_thresholds=known_thresholds)


def _fit_rivals(
    judged: Sequence[tuple[Detections, _Hits]], config: VoxelNetConfig
) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """Fit slope, intercept and weights of rivals per label, and a threshold of the scores that they
    make."""
    rivals = np.concatenate(
        [np.zeros((0, len(config.labels))), *(strongest_rivals(of, config) for of, _ in judged)]
    )
    found = Detections.merge(of for of, _ in judged)
    hits = np.concatenate([np.zeros(0, int), *(at for _, at in judged)])
    rows = []
    thresholds = []
    for number in map(LABELS.index, config.labels):
        own = (hits != UNCOUNTED) & (found.labels == number)
        scores = found.scores[own]
        true = hits[own] == TRUE
        row = (
            platt(scores, true, rivals[own])
            if own.sum() >= FEWEST
            else (1.0, 0.0, *(0.0 for _ in config.labels))
        )
        rows.append(row)
        left = rescore(scores, rivals[own], np.array([row]))
        thresholds.append(round(max(LEAST_SURE, lowest_threshold(left, true, PRECISION)), 3))
    return tuple(rows), tuple(thresholds)


def _judge(
    network: VoxelNet, frames: PackedFrames, count: int | None, seed: int, known: bool = False
) -> list[tuple[Detections, _Hits]]:
    """Judge detections as TRUE, FALSE (a vehicle on a heavy one too, if the network knows both) or
    UNCOUNTED."""
    judged = []
    tells_apart = {"vehicle", "heavy"} <= set(network.config.labels)
    seen = detect_frames(
        network, frames, count=count, seed=seed, subsets=_SUBSETS, errors=_ERRORS, known=known
    )
    for found, truth, counted in seen:
        hits = np.full(len(found), UNCOUNTED)
        for number in map(LABELS.index, network.config.labels):
            known = (truth.labels != HEAVY) | (not tells_apart or number != VEHICLE)
            (at,) = matches(
                found, truth[known], [TRUE_IOU[number]], label=number, counted=counted[known]
            )
            hits[~at.ignored] = np.where(at.truth[~at.ignored] >= 0, TRUE, FALSE)
        judged.append((found, hits))
    return judged


FARTHEST_FACE = 0.6  # m; points of a face farther off are not counted
FEWEST_POINTS = 5  # least points on an object
MATCHED = 0.4  # least BEV IoU of a detection with its object
LOWEST_SCORE = 0.2  # of a detection used as an example
# shares of the frames that some of the sensors see, and sensors with errors
_FACE_SUBSETS = 0.5
_FACE_ERRORS = 0.3
BATCH = 512
STEPS = 5000
LEARNING_RATE = 3e-3
# standard deviations of displaced boxes
OFF = {"centre": 0.1, "yaw": np.deg2rad(1.5), "size": (0.06, 0.07, 0.05)}


class FaceExamples(NamedTuple):
    """Features and offsets outwards (m) by sort of face."""

    features: dict[str, Float32[np.ndarray, "n F"]]
    offsets: dict[str, Float32[np.ndarray, " n"]]


def face_examples(
    frames: PackedFrames,
    network: VoxelNet | None,
    labels: Sequence[str],
    *,
    count: int | None = None,
    seed: int = 0,
) -> FaceExamples:
    """Collect examples of the first `count` frames (None: all). Half of them are seen by a random
    subset of the sensors, some by sensors with errors. network: detects them, without a second
    stage; None for randomly displaced boxes alone."""
    detector_in = (
        None if network is None else detector_by_area(network, score_threshold=LOWEST_SCORE)
    )
    rows, offsets = ({sort: list[np.ndarray]() for sort in SORTS} for _ in range(2))
    wanted = [label_index(label) for label in labels]
    for k in range(min(len(frames), len(frames) if count is None else count)):
        rng = np.random.default_rng([seed, k])
        points = read_points(frames, k, rng, subsets=_FACE_SUBSETS, errors=_FACE_ERRORS)
        objects = frames.level_objects(k)
        there = np.isin(objects.labels, wanted) & has_centre_inside(
            objects.boxes, np.array(frames.rig(k).area)
        )
        objects = objects[there & (count_points(points, objects.boxes) >= FEWEST_POINTS)]
        boxes = off_at_random(objects.boxes, rng)
        truths = objects.boxes
        kinds = objects.labels
        if detector_in is not None:
            found = detector_in(frames.rig(k).area)(points)
            overlap = iou_bev(found.boxes, truths) * (found.labels[:, None] == kinds)
            if overlap.size:
                of_one = overlap.max(axis=1) > MATCHED
                owner = overlap.argmax(axis=1)
                boxes = np.concatenate([boxes, found.boxes[of_one]])
                owner = owner[of_one]
                truths = np.concatenate([truths, truths[owner]])
                kinds = np.concatenate([kinds, kinds[owner]])
        if len(boxes):
            features = face_features(points, boxes, kinds)
            offset = face_offsets(boxes, truths)
            for number, sort in enumerate(SORTS):  # faces with points near them
                seen = features.counted[number] > 0
                rows[sort].append(features[number][seen])
                offsets[sort].append(offset[number][seen])
    moved = {sort: np.concatenate(parts).astype(np.float32) for sort, parts in offsets.items()}
    return FaceExamples({sort: np.concatenate(parts) for sort, parts in rows.items()}, moved)


def train_faces(
    network: VoxelNet,
    frames: PackedFrames,
    labels: Sequence[str],
    *,
    count: int = 1000,
    seed: int = 0,
) -> VoxelNet:
    """Return the network with faces trained for these labels."""
    bare = rebuild(network, faces=())
    staged = rebuild(network, faces=tuple(labels))
    assert staged.faces is not None
    fit_faces(staged.faces, face_examples(frames, bare, labels, count=count, seed=seed), seed=seed)
    return staged


def off_at_random(boxes: BoxRows, rng: Rng) -> BoxRows:
    """Displace boxes in place, size and yaw."""
    boxes = boxes.copy()
    floor = boxes[:, 2] - boxes[:, 5] / 2
    small = np.minimum(boxes[:, 4] / 1.8, 1.0)[:, None]  # less for pedestrians
    boxes[:, :2] += rng.normal(0, OFF["centre"], (len(boxes), 2)) * small
    boxes[:, 3:6] *= 1 + rng.normal(0, OFF["size"], (len(boxes), 3))
    boxes[:, 2] = floor + boxes[:, 5] / 2
    boxes[:, 6] += rng.normal(0, OFF["yaw"], len(boxes)) + np.pi * (rng.random(len(boxes)) < 0.1)
    return boxes


def fit_faces(
    networks: FaceNetworks, examples: FaceExamples, *, steps: int | None = None, seed: int = 0
) -> dict[str, float]:
    """Train the three networks, `STEPS` steps each, on the offsets' Laplace likelihood. Returns the
    mean error (m) of each sort of face before and after, over the examples. Raises ValueError for a
    sort without examples."""
    figures: dict[str, float] = {}
    steps = STEPS if steps is None else steps
    for number, sort in enumerate(SORTS):
        if not len(examples.offsets[sort]):
            raise ValueError(f"no examples of a {sort}: pack frames with vehicles that have points")
        features = torch.from_numpy(examples.features[sort])
        layers = getattr(networks, sort)
        target = torch.from_numpy(examples.offsets[sort]).clamp(-FARTHEST_FACE, FARTHEST_FACE)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            for layer in layers:
                if isinstance(layer, torch.nn.Linear):
                    layer.reset_parameters()
            optimiser = torch.optim.AdamW(layers.parameters(), LEARNING_RATE, weight_decay=1e-3)
            schedule = torch.optim.lr_scheduler.OneCycleLR(
                optimiser, LEARNING_RATE, total_steps=steps, pct_start=0.1
            )
            for _ in range(steps):
                rows = torch.randint(len(target), (BATCH,))
                shift, spread = networks.answers(sort, features[rows])
                loss = ((shift - target[rows]).abs() * torch.exp(-spread) + spread).mean()
                optimiser.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
                schedule.step()
        with torch.inference_mode():
            error = (networks.answers(sort, features)[0] - target).abs().mean()
        networks.prior[number] = target.abs().mean()
        figures |= {f"{sort} before": float(target.abs().mean()), f"{sort} after": float(error)}
    return figures
