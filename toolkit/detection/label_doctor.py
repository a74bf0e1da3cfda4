"""Label doctor: label mistakes that points give away.

A mistake is reported if the boxes fit better without it than chance explains
(`toolkit.detection.label_fits`)."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Points, Pose
from toolkit.boxes import count_points
from toolkit.datasets import records
from toolkit.datasets.dataset import UnknownSite
from toolkit.datasets.doctor import Finding, diagnose_file, suspect_times
from toolkit.datasets.layouts.hdf5 import holds_clouds
from toolkit.datasets.recordings import Part, guess_layout, open_recording
from toolkit.detection.label_fits import (
    MIN_FITTED_BOXES,
    SHIFTS_S,
    Movers,
    Seen,
    better,
    find_movers,
    fits,
    measure_fits,
)
from toolkit.detection.sensor_doctor import diagnose_sensors, diagnose_times, suspect_buried_points
from toolkit.frame import AWAY, Frame
from toolkit.geometry import invert
from toolkit.sites.site import Site

_MIRROR_X = "negate x, and take 180 degrees minus yaw"
_SWAP = "swap x and y, and take 90 degrees minus yaw"
_HALVED = "half extents where full ones belong: the boxes are half as large"
_DOUBLED = "doubled extents: the boxes are twice as large"
_HALF = (1, 1, 1, 0.5, 0.5, 0.5, 1)
_ACROSS = "length and width swapped, or yaw a quarter turn off"
_ADD_QUARTER = "swap length and width, or add 90 degrees to yaw"
_RADIANS = "yaw in radians where degrees belong"
_TO_DEGREES = (1, 1, 1, 1, 1, 1, 180 / np.pi)
MAX_FRAME_SHIFT = 3  # tried delays of clouds without times
MAX_STILL_M = 0.2  # between frames, of an object that does not move
MIN_ALONG_COSINE = 0.7  # between heading and direction of motion, for the two to agree
MIN_TURNED_TRACKS = 2  # that head along their motion only without the mistake
MAX_EMPTY_SHARE = 0.5  # share of labels without a point
MAX_EXPLAINED_EMPTY_SHARE = 0.2  # share of labels without a point, once the mistake is undone
MIN_SUNK_SHARE = 0.3  # share of its height by which the median box is off the ground
MAX_TIED_FIT_GAP = 0.04  # in mean fit; the first of such mistakes in the list is named
MIN_FULL_TURN_SHARE = 0.2  # share of yaws beyond a full turn
_CHECK_UNIT = "check their unit, metres are read"
_REMEDIES = {  # remedies for problems that no sound recording has
    records.STRAY: "name clouds and labels alike, times in the same unit",
    records.NOT_FINITE: "restore them, or remove them",
    records.NO_SIZE: _CHECK_UNIT,
    records.TOO_LARGE: _CHECK_UNIT,
    AWAY: "check their unit, and the frame they are in",
    records.TILTED: "check the order of quaternions, w first or last, and of angles",
    records.EMPTY: "check their sensor, or leave these frames out",
    records.FAR_POINTS: _CHECK_UNIT,
}
MIN_OFFSET_M = 0.3  # from the labels to the points
MAX_OFFSET_M = 5.0  # from the labels to the points
OFFSET_REACH_M = 2.0  # around a box in which its points may be
OFFSET_ROUNDS = 4
MIN_CHOICE_GAIN = 0.1  # in mean fit, for explanations that choose a sensor for each box
MIN_CERTAIN_FIT_SHARE = 0.3  # mean fit of an explanation that is certain
MIN_TURN_GAIN = 0.15  # in mean fit, for explanations that turn each box freely


@dataclass(frozen=True)
class LabelMistake:
    """Mistake that boxes may have, and how to undo it.

    Attributes:
        name: words for the mistake.
        remedy: what to do about it.
        axes: True if it depends on the frame's axes.
        order: columns of the boxes without the mistake.
        factor: factor of each column.
        turn: angle (rad) that is added to yaw.
    """

    name: str
    remedy: str
    axes: bool = False
    order: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6)
    factor: tuple[int | float, ...] = (1, 1, 1, 1, 1, 1, 1)
    turn: float = 0.0

    def undo(self, boxes: BoxRows) -> BoxRows:
        """Return the boxes without the mistake."""
        return boxes[:, list(self.order)] * np.array(self.factor) + np.array(
            [0, 0, 0, 0, 0, 0, self.turn]
        )


YAW_SIGN = LabelMistake(
    "yaw counted the other way round", "negate yaw", True, factor=(1, 1, 1, 1, 1, 1, -1)
)

LOST_DEGREES = LabelMistake(  # not undone directly: `degrees_of_turns` gives the possible angles
    "yaw in degrees where radians belong, of which only sine and cosine are left",
    "multiply yaw by pi / 180 before its sine and cosine are taken",
)

LABEL_MISTAKES = (
    LabelMistake(
        "mirrored: y points the other way", "negate y and yaw", True, factor=(1, -1, 1, 1, 1, 1, -1)
    ),
    LabelMistake(
        "mirrored: x points the other way",
        _MIRROR_X,
        True,
        factor=(-1, 1, 1, 1, 1, 1, -1),
        turn=np.pi,
    ),
    LabelMistake(
        "y of the positions alone negated", "negate y", True, factor=(1, -1, 1, 1, 1, 1, 1)
    ),
    LabelMistake(
        "x and y swapped", _SWAP, True, (1, 0, 2, 3, 4, 5, 6), (1, 1, 1, 1, 1, 1, -1), np.pi / 2
    ),
    LabelMistake(_HALVED, "double the sizes", factor=(1, 1, 1, 2, 2, 2, 1)),
    LabelMistake(_DOUBLED, "halve the sizes", factor=_HALF),
    LabelMistake(_ACROSS, _ADD_QUARTER, order=(0, 1, 2, 4, 3, 5, 6)),
    YAW_SIGN,
    LabelMistake(_RADIANS, "multiply yaw by 180 / pi", True, factor=_TO_DEGREES),
)


def undo_mistake(mistake: LabelMistake, boxes: BoxRows, frame_SE3_world: Pose) -> BoxRows:
    """Undo a mistake that was made in another frame, of boxes (world)."""
    if np.array_equal(frame_SE3_world, np.eye(4)):
        return mistake.undo(boxes)
    undone = mistake.undo(records.move_boxes(frame_SE3_world, boxes))
    return records.move_boxes(invert(frame_SE3_world), undone)


def degrees_of_turns(yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "k n"]:
    """All headings (rad, modulo half a turn) that point along `yaw` once degrees are taken for
    radians.

    A file that stores sine and cosine, or a quaternion, of a wrong angle has lost its full
    turns."""
    turns = np.arange(-15, 16)[:, None]  # of 2 pi "degrees" each: a quarter turn either way
    return np.deg2rad(np.mod(yaw, 2 * np.pi)[None] + 2 * np.pi * turns)


class Shift(NamedTuple):
    """Delay of labels, and fits with and without it.

    amount: delay in words; behind: True if labels are late."""

    amount: str
    behind: bool
    before: Float64[np.ndarray, " n"]
    after: Float64[np.ndarray, " n"]


def find_shift(views: Sequence[Seen]) -> Shift | None:
    """Find the delay of labels, None if there is no clear one.

    Moving labels are moved along their tracks. If that shows nothing, labels are tried in other
    clouds; only labels that are not in the same place in both frames count."""
    from scipy.spatial import cKDTree

    samples = [view.sample for view in views]
    movers = [find_movers(samples, k) for k in range(len(views))]

    def measure_shifted_fits(shift: float) -> np.ndarray:
        return fits(views, [_move_along(moving, shift) for moving in movers])

    if sum(len(moving.boxes) for moving in movers) >= MIN_FITTED_BOXES:
        now = measure_shifted_fits(0.0)
        shifted = {
            sign * seconds: measure_shifted_fits(sign * seconds)
            for seconds in SHIFTS_S
            for sign in (1, -1)
        }
        best = max(shifted, key=lambda shift: shifted[shift].mean())
        if better(now, shifted[best]):
            return Shift(f"{abs(best):g} s", best > 0, now, shifted[best])
    frame_shift: Shift | None = None
    for steps in [sign * k for k in range(1, MAX_FRAME_SHIFT + 1) for sign in (1, -1)]:
        numbers = [k for k in range(len(views)) if 0 <= k + steps < len(views)]
        pairs = [(views[k], views[k + steps]) for k in numbers]
        at_labels = []
        at_clouds = []
        for labels, cloud in pairs:
            to_cloud = invert(cloud.sample.map_SE3_world) @ labels.sample.map_SE3_world
            boxes = records.move_boxes(to_cloud, labels.sample.objects.boxes)
            cloud_boxes = cloud.sample.objects.boxes
            # farther than `MAX_STILL_M` from all labels of the cloud's frame
            is_moving = np.ones(len(boxes), bool)
            if len(boxes) and len(cloud_boxes):
                distances = cKDTree(cloud_boxes[:, :3]).query(boxes[:, :3])[0]
                is_moving = np.asarray(distances > MAX_STILL_M)
            at_labels.append(labels.sample.objects.boxes[is_moving])
            at_clouds.append(boxes[is_moving])
        before = fits([labels for labels, _ in pairs], at_labels)
        after = fits([cloud for _, cloud in pairs], at_clouds)
        if not better(before, after):
            continue
        best_gain = -np.inf
        if frame_shift is not None:
            best_gain = frame_shift.after.mean() - frame_shift.before.mean()
        if after.mean() - before.mean() > best_gain:
            amount = f"{abs(steps)} sample{'s' * (abs(steps) > 1)}"
            frame_shift = Shift(amount, steps < 0, before, after)
    return frame_shift


def _move_along(movers: Movers, seconds: float) -> BoxRows:
    """Boxes of moving objects after some time."""
    path = np.column_stack([seconds * movers.velocities, np.zeros((len(movers.boxes), 5))])
    return movers.boxes + path


class TurnedTracks(NamedTuple):
    """Tracks and moving boxes against their motion, and all moving boxes."""

    tracks: int
    boxes: int
    total: int


def against_their_way(
    samples: Sequence[Frame], undo: Callable[..., np.ndarray]
) -> TurnedTracks | None:
    """Count tracks and boxes that a mistake turns against their motion, and all moving boxes."""
    tracks: set[int] = set()
    mended = 0
    spoilt = 0
    total = 0
    for k, sample in enumerate(samples):
        movers = find_movers(samples, k)
        before = _compare_headings(movers.boxes, movers.velocities)
        after = _compare_headings(undo(sample, movers.boxes), movers.velocities)
        is_turned = (before < 0) & (after > MIN_ALONG_COSINE)
        tracks |= set(movers.ids[is_turned].tolist())
        mended += int(is_turned.sum())
        total += len(movers.boxes)
        spoilt += int(((before > MIN_ALONG_COSINE) & (after < 0)).sum())
    if len(tracks) < MIN_TURNED_TRACKS or mended < MIN_FITTED_BOXES or spoilt > mended / 10:
        return None
    return TurnedTracks(len(tracks), mended, total)


def _compare_headings(
    boxes: BoxRows, velocities: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, " n"]:
    """Cosine between each box's heading and its direction of motion."""
    speeds = np.linalg.norm(velocities, axis=1, keepdims=True)
    directions = velocities / np.maximum(speeds, 1e-9)
    yaw = boxes[:, 6]
    return np.cos(yaw) * directions[:, 0] + np.sin(yaw) * directions[:, 1]


@dataclass(frozen=True)
class Diagnosis:
    """Findings of the doctor, and the words for a recording without any."""

    findings: list[Finding]
    healthy: str = "nothing suspected"


def diagnose(
    path: str | Path, layout: str | None = None, *, site: Site | None = None, frames: int = 20
) -> Diagnosis:
    """Check a recording for the classic mistakes.

    Raises whatever opening a recording of clouds raises. Files of images are checked as they are
    stored (`toolkit.datasets.doctor`). Labels of clouds are checked by the fit of their boxes to
    the points of the first frames."""
    if (layout or guess_layout(path)) == "hdf5":
        try:
            clouds = Path(path).is_file() and holds_clouds(path)
        except (OSError, ValueError):
            clouds = False  # `diagnose_file` names the damage
        if not clouds:
            stored = diagnose_file(path, site)
            return Diagnosis(stored or diagnose_images(path, site, frames))
    samples = list(Part(open_recording(path, layout, site=site), frames))
    untimely = diagnose_times(samples)
    findings = [*find_impossible(samples), *untimely]
    seen = [Seen.of(sample) for sample in samples]
    if not any(len(sample.objects) for sample in samples):
        buried = suspect_buried_points(seen)
        return Diagnosis(
            [*findings, *buried],
            f"{len(samples)} frames without a label: there is nothing to be checked",
        )
    mislabelled = diagnose_boxes(seen)
    sensors = [] if mislabelled else diagnose_sensors(seen, timely=not untimely)
    return Diagnosis([*findings, *mislabelled, *sensors])


def diagnose_images(path: str | Path, site: Site | None, frames: int) -> list[Finding]:
    """Return faults of the sensors in a file of images, compared with each other."""
    try:
        recording = open_recording(path, "hdf5", site=site)
    except UnknownSite:  # points are compared with boxes in the site's frame
        return []
    samples = list(Part(recording, frames))
    return diagnose_sensors(
        [Seen.of(sample) for sample in samples], timely=not diagnose_times(samples)
    )


def find_impossible(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find labels that reading left out, and times that cannot follow each other."""
    problems = sum((Counter(sample.problems) for sample in samples), Counter[str]())
    total = sum(len(sample.objects) for sample in samples)
    if all(len(sample.objects) for sample in samples):
        problems.pop(records.STRAY, None)  # labels of the whole recording with a part of the clouds
    for kind, remedy in _REMEDIES.items():
        if problems[kind]:
            subject = "labels"
            context = f"beside {total} labels that are read"
            if kind in (records.EMPTY, records.FAR_POINTS):
                subject = "clouds"
                context = f"in {len(samples)} frames"
            yield Finding("error", subject, kind, f"{problems[kind]}, {context}", remedy)
    yield from suspect_times(np.array([sample.time for sample in samples]))


def diagnose_labels(samples: Iterable[Frame]) -> list[Finding]:
    """Return mistakes in the labels of consecutive frames."""
    return diagnose_boxes([Seen.of(sample) for sample in samples])


def diagnose_boxes(views: Sequence[Seen]) -> list[Finding]:
    """Return mistakes in the labels of consecutive frames whose ground is known."""
    total = sum(len(view.sample.objects) for view in views)
    turned_count = sum(view.sample.problems.get(records.FULL_TURNS, 0) for view in views)
    if turned_count and turned_count >= MIN_FULL_TURN_SHARE * total:
        evidence = f"{turned_count} of {total} yaws are beyond a full turn in radians"
        words = "yaw in degrees where radians belong"
        return [Finding("error", "labels", words, evidence, "multiply yaw by pi / 180")]
    boxes = [view.sample.objects.boxes for view in views]
    findings = list[Finding]()
    current = fits(views, boxes)
    best = _find_best(views, current)
    # a choice for each box explains an offset too
    is_free = best is not None and best.mistake is LOST_DEGREES
    margin = -MIN_CHOICE_GAIN if is_free else MAX_TIED_FIT_GAP
    best = _clearer(best, _find_offset(views, current), margin)
    if best is not None:
        findings.append(_finding(best.mistake.name, current, best.fits, best.mistake.remedy))
        boxes = best.boxes
    findings += suspect_heights(views, boxes)
    if findings:
        return findings
    empty = [*suspect_empty(views)]
    if empty:
        return empty
    shift = find_shift(views)
    if shift is not None:
        side = "behind" if shift.behind else "ahead of"
        sign = "+" if shift.behind else "-"
        name = f"labels lie about {shift.amount} {side} the clouds"
        remedy = f"move labels by {sign}{shift.amount} along their way, or pair other clouds"
        return [_finding(name, shift.before, shift.after, remedy)]
    turned = _turn_each(views)
    if better(current, turned.fits, MIN_TURN_GAIN):
        return [_finding(LOST_DEGREES.name, current, turned.fits, LOST_DEGREES.remedy)]
    return suspect_headings([view.sample for view in views])


def suspect_heights(views: Sequence[Seen], boxes: Sequence[BoxRows]) -> list[Finding]:
    """Find boxes whose z is the height of their floor or roof."""
    shares = [np.zeros(0)]  # heights of centres above the ground, in heights of their boxes
    for view, rows in zip(views, boxes, strict=True):
        if view.ground is not None:
            shares.append((rows[:, 2] - view.ground.height(rows[:, :2])) / rows[:, 5])
    pooled = np.concatenate(shares)
    share = float(np.median(pooled)) if len(pooled) >= MIN_FITTED_BOXES else 0.5
    if not abs(share - 0.5) >= MIN_SUNK_SHARE:
        return []
    side = "floor" if share < 0.5 else "roof"
    remedy = "add half the height to z" if share < 0.5 else "take half the height off z"
    words = f"the centre of the {side} where the centre of the box belongs"
    evidence = (
        f"the stored centres stand {share:.0%} of the boxes' heights above the ground, median "
        f"of {len(pooled)}"
    )
    return [Finding("error", "labels", words, evidence, remedy)]


def suspect_headings(samples: Sequence[Frame]) -> list[Finding]:
    """Find moving boxes whose yaw has the wrong sign, in the world or in the map."""
    undos = (
        lambda _, boxes: YAW_SIGN.undo(boxes),
        lambda sample, boxes: undo_mistake(YAW_SIGN, boxes, sample.map_SE3_world),
    )
    for undo in undos:
        turned = against_their_way(samples, undo)
        if turned is not None:
            evidence = (
                f"{turned.boxes} of {turned.total} boxes that move, of {turned.tracks} objects, "
                "head against their way, and along it with that undone"
            )
            return [Finding("error", "labels", YAW_SIGN.name, evidence, YAW_SIGN.remedy)]
    return []


class OtherFrame(NamedTuple):
    """Mistake of labels in another frame than the world, and the boxes in the world without it."""

    mistake: LabelMistake
    choose: Callable[[Frame], list[BoxRows]]


def other_frames(samples: Sequence[Frame]) -> list[OtherFrame]:
    """Return the frames that labels may be in by mistake: each sensor's, and the map's."""
    names = sorted({cloud.name for sample in samples for cloud in sample.clouds})
    wrong = []
    for name in names:
        find_pose = partial(_find_pose, name)
        stated = f"labels are in the frame of sensor {name}, not in the world"
        wrong.append(
            _make_other_frame(
                find_pose, stated, f"move them by the pose of {name}, or name their frame"
            )
        )
    for name in names:
        find_inverse = partial(_find_inverse, name)
        away = f"labels were moved into the frame of sensor {name}, away from the world"
        wrong.append(_make_other_frame(find_inverse, away, "leave them in the world"))
    in_map = "labels are in the map, not in the world"
    remedy = "move them by the pose of the vehicle"
    wrong.append(_make_other_frame(lambda sample: invert(sample.map_SE3_world), in_map, remedy))
    return wrong


def _find_pose(name: str, sample: Frame) -> Pose:
    """Pose of a frame's sensor, identity if the frame lacks it."""
    return next(
        (cloud.world_SE3_sensor for cloud in sample.clouds if cloud.name == name), np.eye(4)
    )


def _find_inverse(name: str, sample: Frame) -> Pose:
    return invert(_find_pose(name, sample))


def _make_other_frame(
    world_SE3_labels: Callable[[Frame], Pose], name: str, remedy: str
) -> OtherFrame:
    def choose(sample: Frame) -> list[BoxRows]:
        return [records.move_boxes(world_SE3_labels(sample), sample.objects.boxes)]

    return OtherFrame(LabelMistake(name, remedy), choose)


def suspect_empty(views: Sequence[Seen]) -> Iterator[Finding]:
    """Find labels that mostly hold no point of any sensor, and the frame in which they would hold
    some."""
    empty, total = _count_empty(views, [view.sample.objects.boxes for view in views])
    if not total or empty / total <= MAX_EMPTY_SHARE:
        return
    observation = f"{empty} of {total} boxes hold no point above the ground"
    samples = [view.sample for view in views]
    undone = [
        _undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    best = max(undone, key=lambda attempt: float(attempt.fits.mean()))
    left_empty, _ = _count_empty(views, best.boxes)
    if left_empty / total <= MAX_EXPLAINED_EMPTY_SHARE:
        evidence = f"{observation}, {left_empty} with that undone"
        yield Finding("error", "labels", best.mistake.name, evidence, best.mistake.remedy)
        return
    remedy = (
        "check the frame and unit of labels, the poses of sensors, and that labels and clouds "
        "belong together"
    )
    yield Finding("warning", "labels", "boxes without a point from any sensor", observation, remedy)


def _count_empty(views: Sequence[Seen], boxes: Sequence[BoxRows]) -> tuple[int, int]:
    """Count boxes without a point above the ground, and all boxes."""
    counts = [
        count_points(view.points, rows)
        for view, rows in zip(views, boxes, strict=True)
        if len(rows)
    ]
    inside = np.concatenate([np.zeros(0, np.int64), *counts])
    return int((inside == 0).sum()), len(inside)


class _Undone(NamedTuple):
    """Mistake, the boxes without it, and their fits."""

    mistake: LabelMistake
    boxes: list[np.ndarray]
    fits: np.ndarray


def _find_best(views: Sequence[Seen], current: np.ndarray) -> _Undone | None:
    """Find the mistake whose undoing raises the fits most.

    Explanations with a choice for each box must fit clearly better."""

    def undo(mistake: LabelMistake, frames: Callable[[Frame], Sequence[np.ndarray]]) -> _Undone:
        def choose(sample: Frame) -> list[np.ndarray]:
            return [undo_mistake(mistake, sample.objects.boxes, frame) for frame in frames(sample)]

        return _undo_each(mistake, views, choose)

    def in_sensors(sample: Frame) -> list[np.ndarray]:
        return [invert(cloud.world_SE3_sensor) for cloud in sample.clouds] or [np.eye(4)]

    in_axes = [mistake for mistake in LABEL_MISTAKES if mistake.axes]
    samples = [view.sample for view in views]
    frames = [
        _undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    attempts = [undo(mistake, lambda _: [np.eye(4)]) for mistake in LABEL_MISTAKES]
    if any(not np.allclose(view.sample.map_SE3_world, np.eye(4)) for view in views):
        attempts += [undo(mistake, lambda sample: [sample.map_SE3_world]) for mistake in in_axes]
    plain = _find_most([*attempts, *frames], current)
    by_sensor = [undo(mistake, in_sensors) for mistake in in_axes]
    chosen_sensor = _find_most(by_sensor, current, MIN_CHOICE_GAIN)
    best = _clearer(plain, chosen_sensor, MIN_CHOICE_GAIN)
    if best is None:
        return None
    return _clearer(best, _turn_each(views), MIN_TURN_GAIN if best is plain else MIN_CHOICE_GAIN)


def _find_most(attempts: Sequence[_Undone], current: np.ndarray, *gain: float) -> _Undone | None:
    """Return the first of the mistakes that fit nearly best, None if none improves the fits."""
    surer = [attempt for attempt in attempts if better(current, attempt.fits, *gain)]
    means = _means(surer) if surer else []
    for attempt, mean in zip(surer, means, strict=True):
        if mean >= max(means) - MAX_TIED_FIT_GAP:
            return attempt
    return None


def _clearer(best: _Undone | None, freer: _Undone | None, margin: float) -> _Undone | None:
    """Return the freer explanation if it wins by a margin."""
    if best is None or freer is None:
        return best or freer
    best_mean, freer_mean = _means([best, freer])
    return freer if freer_mean > best_mean + margin else best


def _means(attempts: Sequence[_Undone]) -> list[float]:
    """Mean fit under each explanation, over the same boxes."""
    has_fit = np.any([attempt.fits > 0 for attempt in attempts], axis=0)
    return [float(attempt.fits[has_fit].mean()) for attempt in attempts]


def _find_offset(views: Sequence[Seen], current: Float64[np.ndarray, " n"]) -> _Undone | None:
    """Find one horizontal offset of all labels from the points.

    Returns None if undoing it does not fit better."""
    boxes = [view.sample.objects.boxes for view in views]
    offset = np.zeros(2)
    for _ in range(OFFSET_ROUNDS):
        moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
        view_offsets = [
            _measure_offsets(view.points, rows) for view, rows in zip(views, moved, strict=True)
        ]
        offsets = np.concatenate([np.zeros((0, 2)), *view_offsets])
        if len(offsets) < MIN_FITTED_BOXES:
            return None
        offset = offset - np.median(offsets, axis=0)
    moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
    if not MIN_OFFSET_M <= np.hypot(*offset) <= MAX_OFFSET_M:
        return None
    undone = fits(views, moved)
    if not better(current, undone):
        return None
    words = (
        f"all labels are {offset[0]:+.1f} m in x and {offset[1]:+.1f} m in y from where the "
        "points are"
    )
    remedy = (
        "take that off, and check which point of the vehicle, of the lidar or of the map they "
        "are counted from"
    )
    return _Undone(LabelMistake(words, remedy), moved, undone)


def _measure_offsets(points: Points, boxes: BoxRows) -> Float64[np.ndarray, "n 2"]:
    """Offsets of the points around boxes from the boxes' centres; boxes without points are
    skipped."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(boxes):
        return np.zeros((0, 2))
    tree = cKDTree(points[:, :2])
    neighbours = tree.query_ball_point(
        boxes[:, :2], np.hypot(boxes[:, 3], boxes[:, 4]) / 2 + OFFSET_REACH_M
    )
    rows = [
        np.median(points[point_rows, :2], axis=0) - box[:2]
        for point_rows, box in zip(neighbours, boxes, strict=True)
        if point_rows
    ]
    return np.array(rows).reshape(-1, 2)


def _turn_each(views: Sequence[Seen]) -> _Undone:
    def turn(sample: Frame) -> list[np.ndarray]:
        rows = sample.objects.boxes
        return [np.column_stack([rows[:, :6], yaw]) for yaw in degrees_of_turns(rows[:, 6])]

    return _undo_each(LOST_DEGREES, views, turn)


def _undo_each(
    mistake: LabelMistake, views: Sequence[Seen], choose: Callable[[Frame], Sequence[np.ndarray]]
) -> _Undone:
    """Take the choice with the best fit for every box."""
    boxes = []
    for view in views:
        choices = choose(view.sample)
        best = np.zeros(len(choices[0]), np.int64)
        if len(choices) > 1:
            best = np.argmax([measure_fits(view.points, rows) for rows in choices], axis=0)
        boxes.append(np.stack(choices)[best, np.arange(len(choices[0]))])
    return _Undone(mistake, boxes, fits(views, boxes))


def _finding(name: str, before: np.ndarray, after: np.ndarray, remedy: str) -> Finding:
    share = f"{before.mean():.0%} as they are, {after.mean():.0%} with that undone"
    if after.mean() < MIN_CERTAIN_FIT_SHARE:
        remedy += (
            "; few boxes fit even then, so the cause may be another, such as a shift: draw a "
            "frame by coview view"
        )
    return Finding(
        "error", "labels", name, f"mean fit of {len(before)} boxes to the points: {share}", remedy
    )
