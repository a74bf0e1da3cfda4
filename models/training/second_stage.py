"""Second stage of a network: measured AP, calibrated scores, measured faces, more classes.

Calibration turns scores into shares of true detections and finds thresholds above which nearly all
are true. Faces are fitted to boxes as detected and to boxes displaced at random, by more than the
detector's errors on vehicles it knows. So the points must count, not the first stage's sizes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize

from models.config import FITTED, VoxelNetConfig
from models.detector import VoxelNetDetector
from models.detector_loading import relocate
from models.network.candidates import logit, rescore, sigmoid, strongest_rivals
from models.network.faces import SORTS, FaceNetworks, face_features, face_offsets
from models.network.voxelnet import VoxelNet
from models.training.packed import Area, PackedFrames, Rig
from models.training.samples import read_sample_points
from toolkit.arrays import BoxRows, Float, Float32, Int64, Mask, Rng
from toolkit.boxes import count_points, iou_bev
from toolkit.detection.background import EMPTY_SWEEPS, Background, KnownBackground
from toolkit.detection.metrics import TRUE_IOU, evaluate, matches
from toolkit.geometry import level_rows
from toolkit.objects import HEAVY, LABELS, VEHICLE, Detections, Detector, Objects, label_index
from toolkit.points import has_centre_inside

_Scores = Float[np.ndarray, " n"]
_Hits = Int64[np.ndarray, " n"]  # TRUE, FALSE or UNCOUNTED for each detection

IOU_THRESHOLDS = (0.7, 0.8, 0.9)
# for cyclists, pedestrians and heavy vehicles, which are small, or vary more
OTHER_THRESHOLDS = (0.25, 0.5, 0.7)
MAX_KEPT_AREAS = 4
MIN_PRECISION = 0.97  # share of true detections above the chosen threshold
MAX_LOST_SHARE = 0.05  # true detections that a threshold may lose at any precision
MIN_DETECTIONS = 30  # a class with fewer keeps its scores
MIN_FIT_SCORE = 0.05  # detections with less are not used for calibration
MIN_THRESHOLD = 0.2  # lowest default threshold of a calibrated score
TRUE = 1  # outcome of a detection
FALSE = 0  # outcome of a detection
UNCOUNTED = -1  # outcome of a detection
_SUBSET_SHARE = 0.3  # frames seen by some of the sensors
_ERROR_SHARE = 0.3  # frames seen by sensors with errors
_RIDGE = 1.0  # pulls the slope to 1 and the intercept to 0
_MIN_SLOPE = 0.05
MAX_FACE_SHIFT_M = 0.6  # points of a face farther off are not counted
MIN_OBJECT_POINTS = 5
MIN_MATCH_IOU = 0.4  # BEV IoU of a detection with its object
MIN_EXAMPLE_SCORE = 0.2  # detections with less are not used as examples
_FACE_SUBSET_SHARE = 0.5  # frames seen by some of the sensors
_FACE_ERROR_SHARE = 0.3  # frames seen by sensors with errors
FACE_BATCH = 512
FACE_STEPS = 5000
FACE_LEARNING_RATE = 3e-3
# standard deviations of displaced boxes
BOX_DEVIATIONS = {"centre": 0.1, "yaw": np.deg2rad(1.5), "size": (0.06, 0.07, 0.05)}
# names of the weights that have channels of their own for each anchor
_MAPS = tuple(f"head.{name}." for name in ("classes", "residuals", "direction", "quality"))


class ComparedFrame(NamedTuple):
    """Detections of a frame and its truth.

    Attributes:
        detections: Detections.
        truth: Objects of the frame.
        counted: True for the objects that are centred in the frame's area.
    """

    detections: Detections
    truth: Objects
    counted: Mask


class _JudgedFrame(NamedTuple):
    """Detections of a frame, each with its outcome."""

    detections: Detections
    hits: _Hits


def detector_by_area(
    network: VoxelNet, device: str | torch.device = "cpu", score_threshold: float | None = 0.05
) -> Callable[[Area], Detector]:
    """Function from an area to the network's detector there.

    score_threshold: lowest score of a detection, None for the network's thresholds.
    """

    # each detector has its anchors on the whole area, and a packed file may have thousands of areas
    @lru_cache(maxsize=MAX_KEPT_AREAS)
    def make_detector(area: Area) -> Detector:
        return VoxelNetDetector(
            relocate(network, area, "general"), device=device, score_threshold=score_threshold
        )

    return make_detector


def detect_recording(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    subsets: float = 0.0,
    errors: float = 0.0,
    known: bool = False,
) -> list[ComparedFrame]:
    """Detections and truth of the first `count` frames (None: all), by early fusion.

    seed: for noise, subsets and errors. subsets: chance that a frame is seen by a random set of the
    sensors; errors: chance that its sensors have random errors. known: leave out detections of the
    empty site.
    """
    was_training = network.training  # making a detector ends it
    detector_in = detector_by_area(network, device, MIN_FIT_SCORE)
    results = []
    background = lru_cache(maxsize=MAX_KEPT_AREAS)(_background)
    for k in range(len(frames) if count is None else min(len(frames), count)):
        area = frames.rig(k).area
        points = read_sample_points(
            frames, k, np.random.default_rng([seed, k]), subsets=subsets, errors=errors
        )
        truth = frames.level_objects(k)
        detector = detector_in(area)
        if known:
            detector = KnownBackground(detector, background(frames.rig(k)))
        is_counted = has_centre_inside(truth.boxes, np.array(area))
        results.append(ComparedFrame(detector(points), truth, is_counted))
    network.train(was_training)
    return results


def _background(rig: Rig) -> Background:
    """Background of the empty site, from noisy sweeps of a rig."""
    rng = np.random.default_rng(0)
    no_pixels = np.zeros(0, np.uint32)
    sweeps = []
    for _ in range(EMPTY_SWEEPS):
        for s in range(len(rig.sensors)):
            sweep = rig.measure(s, changed=no_pixels, measured=no_pixels, rng=rng)
            sweeps.append(level_rows(sweep.points, rig.slope))
    return Background.learn(np.concatenate(sweeps))


def compute_recording_ap(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> dict[str, float]:
    """AP3D of early fusion over the first `count` frames (None: all), in the protocol "exact".

    Names are "AP@0.7" and so on for vehicles, "pedestrian AP@0.5" and so on for others; other
    classes without objects are left out. seed: for the sensors' noise.
    """
    results = detect_recording(network, frames, count=count, seed=seed, device=device)
    detections = tuple(result.detections for result in results)
    truths = tuple(result.truth for result in results)
    counted = tuple(result.counted for result in results)
    aps: dict[str, float] = {}
    for label in network.config.labels:
        is_vehicle = label == LABELS[VEHICLE]
        thresholds, prefix = (IOU_THRESHOLDS, "") if is_vehicle else (OTHER_THRESHOLDS, f"{label} ")
        by_iou = evaluate(
            detections, truths, iou_thresholds=thresholds, counted=counted, label=label
        )
        for iou, figures in by_iou.items():
            if figures.truths or is_vehicle:
                aps[f"{prefix}AP@{iou:g}"] = figures.ap
    return aps


def widen(network: VoxelNet, config: VoxelNetConfig) -> VoxelNet:
    """Network widened to the classes of `config`.

    Weights of shared classes are taken over, with their anchors; anchors of new classes start at
    random, always the same. A network of the same classes without a second stage is returned
    unchanged.
    """
    old_config = network.config
    if old_config.labels == config.labels and not old_config.faces:
        return network
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        # a second stage and calibration must be fitted again
        no_fits: dict[str, Any] = dict.fromkeys(("faces", *FITTED), ())
        wider = VoxelNet(replace(old_config, labels=config.labels, kinds=config.kinds, **no_fits))
    state = wider.state_dict()
    for name, old_weight in network.state_dict().items():
        # in the head's maps the channels of shared anchors come from the old network, others stay
        # random; all other layers are taken over whole
        if name.startswith(_MAPS):
            channels = len(state[name]) // len(wider.config.anchor_labels)  # one anchor's
            for label in set(config.labels) & set(old_config.labels):
                rows = _channels(wider.config, label, channels)
                old_rows = _channels(old_config, label, channels)
                if len(rows) == len(old_rows):
                    state[name][rows] = old_weight[old_rows]
        elif name in state:
            state[name] = old_weight
    wider.load_state_dict(state)
    return wider


def rebuild(network: VoxelNet, **changes: Any) -> VoxelNet:
    """Network with the same weights and some changed entries of its configuration.

    New parts start at random.
    """
    rebuilt = VoxelNet(replace(network.config, **changes))
    state = rebuilt.state_dict()
    state |= {name: tensor for name, tensor in network.state_dict().items() if name in state}
    rebuilt.load_state_dict(state)
    return rebuilt.train(network.training)


def _channels(config: VoxelNetConfig, label: str, per_anchor: int) -> list[int]:
    """Numbers of the channels of a class's anchors. per_anchor: channels of one anchor."""
    anchors = [
        anchor for anchor, row in enumerate(config.anchor_labels) if config.labels[row] == label
    ]
    return [anchor * per_anchor + channel for anchor in anchors for channel in range(per_anchor)]


def platt(
    scores: _Scores, hits: Mask, rivals: Float[np.ndarray, "n labels"] | None = None
) -> tuple[float, ...]:
    """Slope, intercept and the weights (at least 0) of L rivals' scores, fitted to hits (Platt
    1999).

    They make sigmoid(slope · logit(score) + intercept - Σ weight · rival) the likeliest share of
    true detections. hits: True for the true detections. rivals: scores of each one's rivals, None
    for a fit without them (L = 0).
    """
    rivals = np.zeros((len(scores), 0)) if rivals is None else rivals
    rows = np.column_stack([logit(scores), np.ones(len(scores)), -rivals])
    neutral = np.eye(1, rows.shape[1])[0]  # slope 1, all others 0: scores stay as they are

    def loss_and_gradient(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Log loss of parameters, and its gradient.

        It rises by the squared distance from `neutral`, the parameters that change no score."""
        log_odds = rows @ parameters
        deviation = parameters - neutral
        loss = float(
            np.logaddexp(0.0, log_odds).sum()
            - log_odds[hits].sum()
            + _RIDGE / 2 * deviation @ deviation
        )
        return loss, rows.T @ (sigmoid(log_odds) - hits) + _RIDGE * deviation

    # for the slope, the intercept and each weight
    bounds = [(_MIN_SLOPE, None), (None, None), *((0.0, None) for _ in rivals.T)]
    solution = minimize(
        loss_and_gradient,
        neutral,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-7},
    )
    return tuple(float(value) for value in solution.x)


def lowest_threshold(scores: _Scores, hits: Mask, precision: float) -> float:
    """Lowest score above which a share `precision` of detections is true, 0 for all detections.

    If fewer than `MIN_DETECTIONS` reach that share, it is the score above which that many remain;
    but never a score that loses more than `MAX_LOST_SHARE` of the true detections. hits: True for
    the true detections."""
    order = np.argsort(-scores, kind="stable")
    count = np.arange(1, len(order) + 1)
    share = np.cumsum(hits[order]) / count  # true among the `count` best
    good_rows = np.flatnonzero((share >= precision) & (count >= MIN_DETECTIONS))
    kept_count = good_rows[-1] + 1 if len(good_rows) else min(MIN_DETECTIONS, len(order))
    # the best score that is left out, since a detection must be above the threshold
    threshold = float(scores[order][kept_count]) if kept_count < len(order) else 0.0
    true_scores = np.sort(scores[hits])
    if not len(true_scores):
        return threshold
    lowest_true_score = true_scores[int(MAX_LOST_SHARE * len(true_scores))]
    return min(threshold, float(np.nextafter(lowest_true_score, 0.0)))


def fit_calibration(
    network: VoxelNet, frames: PackedFrames, *, count: int | None = None, seed: int = 0
) -> VoxelNet:
    """Network with calibration, rivalry and a threshold per class.

    Each threshold is the lowest above which `MIN_PRECISION` of the detections are true, over the
    first `count` frames (None: all) of a file that training did not use. Some are seen by only
    some sensors or by sensors with errors."""
    uncalibrated = rebuild(network, score_threshold=MIN_FIT_SCORE, **dict.fromkeys(FITTED, ()))
    labels = uncalibrated.config.labels
    judged = _judge(uncalibrated, frames, count, seed)
    hits = _join_hits(judged)
    merged = Detections.merge(frame.detections for frame in judged)
    calibration: list[tuple[float, ...]] = []  # slope and intercept of each label
    for label in labels:
        is_label = (hits != UNCOUNTED) & (merged.labels == LABELS.index(label))
        pair: tuple[float, ...] = (1.0, 0.0)
        if is_label.sum() >= MIN_DETECTIONS:
            pair = platt(merged.scores[is_label], hits[is_label] == TRUE)
        calibration.append(pair)
    by_label = dict(zip(map(LABELS.index, labels), calibration, strict=True))
    calibrated_frames = []
    for detections, frame_hits in judged:
        pairs = [by_label[int(label)] for label in detections.labels]
        slope, intercept = np.array(pairs).reshape(-1, 2).T
        scores = sigmoid(slope * logit(detections.scores) + intercept)
        rescored = Detections(detections.boxes, scores, detections.labels)
        calibrated_frames.append(_JudgedFrame(rescored, frame_hits))
    rivalry, thresholds = _fit_rivals(calibrated_frames, uncalibrated.config)
    calibrated = rebuild(
        uncalibrated, calibration=tuple(calibration), rivalry=rivalry, thresholds=thresholds
    )
    if any(map(frames.is_recorded, range(len(frames)))):  # the empty site is unknown
        return calibrated
    known_rivalry, known_thresholds = _fit_rivals(
        _judge(calibrated, frames, count, seed, known=True), uncalibrated.config
    )
    return rebuild(calibrated, known=known_rivalry, known_thresholds=known_thresholds)


def _join_hits(judged: Sequence[_JudgedFrame]) -> _Hits:
    """Outcomes of the detections of all frames, in their order."""
    return np.concatenate([np.zeros(0, int), *[frame.hits for frame in judged]])


def _fit_rivals(
    judged: Sequence[_JudgedFrame], config: VoxelNetConfig
) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """Slope, intercept and weights of rivals for each label, and a threshold of its new scores.

    Rivals of a detection are boxes of other labels that overlap it.

    judged: detections of some frames, and which of them are true; labels with fewer than
    `MIN_DETECTIONS` keep their scores."""
    # the strongest rival's score by label (column), for each detection of all frames (row)
    frame_rivals = [np.zeros((0, len(config.labels)))]
    frame_rivals += [strongest_rivals(frame.detections, config) for frame in judged]
    rivals = np.concatenate(frame_rivals)
    all_detections = Detections.merge(frame.detections for frame in judged)
    hits = _join_hits(judged)
    rows = []
    thresholds = []
    for number in map(LABELS.index, config.labels):
        is_label = (hits != UNCOUNTED) & (all_detections.labels == number)
        scores = all_detections.scores[is_label]
        is_true = hits[is_label] == TRUE
        # slope, intercept and weights that leave the scores as they are
        row: tuple[float, ...] = (1.0, 0.0) + (0.0,) * len(config.labels)
        if is_label.sum() >= MIN_DETECTIONS:
            row = platt(scores, is_true, rivals[is_label])
        rows.append(row)
        new_scores = rescore(scores, rivals[is_label], np.array([row]))
        threshold = lowest_threshold(new_scores, is_true, MIN_PRECISION)
        thresholds.append(round(max(MIN_THRESHOLD, threshold), 3))
    return tuple(rows), tuple(thresholds)


def _judge(
    network: VoxelNet, frames: PackedFrames, count: int | None, seed: int, known: bool = False
) -> list[_JudgedFrame]:
    """Detections of each frame with their outcome: TRUE, FALSE or UNCOUNTED.

    If the network knows vehicles and heavy vehicles, a vehicle on a heavy one is FALSE too.

    count: number of first frames, None for all; seed: for noise, subsets of sensors and errors;
    known: True to leave out detections of the empty site."""
    judged = []
    knows_both = {"vehicle", "heavy"} <= set(network.config.labels)
    results = detect_recording(
        network,
        frames,
        count=count,
        seed=seed,
        subsets=_SUBSET_SHARE,
        errors=_ERROR_SHARE,
        known=known,
    )
    for detections, truth, counted in results:
        hits = np.full(len(detections), UNCOUNTED)
        for number in map(LABELS.index, network.config.labels):
            # all objects, but no heavy ones for vehicles: a detection on them is not ignored
            is_target = (truth.labels != HEAVY) | (not knows_both or number != VEHICLE)
            (match,) = matches(
                detections,
                truth[is_target],
                [TRUE_IOU[number]],
                label=number,
                counted=counted[is_target],
            )
            # of the detections that count; their object is negative if they hit none
            hits[~match.ignored] = np.where(match.truth[~match.ignored] >= 0, TRUE, FALSE)
        judged.append(_JudgedFrame(detections, hits))
    return judged


class FaceExamples(NamedTuple):
    """Examples for the face networks, by sort of face.

    Attributes:
        features: Inputs of the network.
        offsets: Distance of the true face from the box's face outwards (m).
    """

    features: dict[str, Float32[np.ndarray, "n features"]]
    offsets: dict[str, Float32[np.ndarray, " n"]]


def face_examples(
    frames: PackedFrames,
    network: VoxelNet | None,
    labels: Sequence[str],
    *,
    count: int | None = None,
    seed: int = 0,
) -> FaceExamples:
    """Examples from objects of these classes in the first `count` frames (None: all).

    Half of the frames are seen by a random subset of the sensors, some by sensors with errors.
    Boxes are true ones displaced at random, and detections of `network`, which has no second stage;
    None: only the displaced ones.
    """
    detector_in = (
        None if network is None else detector_by_area(network, score_threshold=MIN_EXAMPLE_SCORE)
    )
    feature_parts = {sort: list[np.ndarray]() for sort in SORTS}
    offset_parts = {sort: list[np.ndarray]() for sort in SORTS}
    label_numbers = [label_index(label) for label in labels]
    for k in range(min(len(frames), len(frames) if count is None else count)):
        rng = np.random.default_rng([seed, k])
        points = read_sample_points(
            frames, k, rng, subsets=_FACE_SUBSET_SHARE, errors=_FACE_ERROR_SHARE
        )
        objects = frames.level_objects(k)
        is_class = np.isin(objects.labels, label_numbers)
        is_inside = has_centre_inside(objects.boxes, np.array(frames.rig(k).area))
        has_points = count_points(points, objects.boxes) >= MIN_OBJECT_POINTS
        objects = objects[is_class & is_inside & has_points]
        boxes = displace_boxes(objects.boxes, rng)
        truths = objects.boxes  # the true box of each of `boxes`
        classes = objects.labels
        if detector_in is not None:
            detections = detector_in(frames.rig(k).area)(points)
            iou = iou_bev(detections.boxes, truths) * (detections.labels[:, None] == classes)
            if iou.size:
                is_matched = iou.max(axis=1) > MIN_MATCH_IOU
                owner = iou.argmax(axis=1)[is_matched]
                boxes = np.concatenate([boxes, detections.boxes[is_matched]])
                truths = np.concatenate([truths, truths[owner]])
                classes = np.concatenate([classes, classes[owner]])
        if len(boxes):
            features = face_features(points, boxes, classes)
            shifts = face_offsets(boxes, truths)
            for number, sort in enumerate(SORTS):  # faces with points near them
                has_face_points = features.counted[number] > 0
                feature_parts[sort].append(features[number][has_face_points])
                offset_parts[sort].append(shifts[number][has_face_points])
    return FaceExamples(
        features={sort: np.concatenate(parts) for sort, parts in feature_parts.items()},
        offsets={
            sort: np.concatenate(parts).astype(np.float32) for sort, parts in offset_parts.items()
        },
    )


def train_faces(
    network: VoxelNet,
    frames: PackedFrames,
    labels: Sequence[str],
    *,
    count: int = 1000,
    seed: int = 0,
) -> VoxelNet:
    """Network with a second stage trained for the faces of these classes.

    The second stage learns from boxes that a network without it detects. labels: the classes;
    count: number of frames for examples; seed: for their noise and the training.
    """
    first_stage = rebuild(network, faces=())
    both_stages = rebuild(network, faces=tuple(labels))
    assert both_stages.faces is not None
    examples = face_examples(frames, first_stage, labels, count=count, seed=seed)
    fit_faces(both_stages.faces, examples, seed=seed)  # trains them in place
    return both_stages


def displace_boxes(boxes: BoxRows, rng: Rng) -> BoxRows:
    """Copy of boxes with random errors of place, size and yaw, a tenth reversed; the floor stays.

    boxes: x, y, z of the centre, length, width, height (m), yaw (rad)."""
    boxes = boxes.copy()
    width = boxes[:, 4]
    floor = boxes[:, 2] - boxes[:, 5] / 2
    # errors of the place are smaller for what is narrower than a car of 1.8 m
    width_share = np.minimum(width / 1.8, 1.0)[:, None]
    boxes[:, :2] += rng.normal(0, BOX_DEVIATIONS["centre"], (len(boxes), 2)) * width_share
    boxes[:, 3:6] *= 1 + rng.normal(0, BOX_DEVIATIONS["size"], (len(boxes), 3))
    boxes[:, 2] = floor + boxes[:, 5] / 2  # with the new height
    turn = rng.normal(0, BOX_DEVIATIONS["yaw"], len(boxes))
    is_reversed = rng.random(len(boxes)) < 0.1
    boxes[:, 6] += turn + np.pi * is_reversed
    return boxes


def fit_faces(
    networks: FaceNetworks, examples: FaceExamples, *, steps: int | None = None, seed: int = 0
) -> dict[str, float]:
    """Train the three networks, `FACE_STEPS` steps each, on the offsets' Laplace likelihood.

    Returns the mean error (m) over the examples before and after, as "end before", "end after" and
    so on for each of `SORTS`. Raises ValueError for a sort without examples.
    """
    errors_m: dict[str, float] = {}
    steps = FACE_STEPS if steps is None else steps
    for number, sort in enumerate(SORTS):
        if not len(examples.offsets[sort]):
            raise ValueError(f"no examples of a {sort}: pack frames with vehicles that have points")
        features = torch.from_numpy(examples.features[sort])
        layers = getattr(networks, sort)
        target = torch.from_numpy(examples.offsets[sort]).clamp(-MAX_FACE_SHIFT_M, MAX_FACE_SHIFT_M)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            for layer in layers:
                if isinstance(layer, torch.nn.Linear):
                    layer.reset_parameters()
            optimiser = torch.optim.AdamW(
                layers.parameters(), FACE_LEARNING_RATE, weight_decay=1e-3
            )
            schedule = torch.optim.lr_scheduler.OneCycleLR(
                optimiser, FACE_LEARNING_RATE, total_steps=steps, pct_start=0.1
            )
            for _ in range(steps):
                rows = torch.randint(len(target), (FACE_BATCH,))
                shift, spread = networks.answers(sort, features[rows])
                # Laplace: |error| / e^spread + spread, the log of the scale
                loss = ((shift - target[rows]).abs() * torch.exp(-spread) + spread).mean()
                optimiser.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
                schedule.step()
        with torch.inference_mode():
            shift, _ = networks.answers(sort, features)
            error = (shift - target).abs().mean()
        networks.prior[number] = target.abs().mean()
        errors_m |= {f"{sort} before": float(target.abs().mean()), f"{sort} after": float(error)}
    return errors_m
