"""Label doctor: label mistakes that points give away. One is reported if undoing it fits better
than by chance.

How well boxes fit is measured by `toolkit.detection.label_fits`."""

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
    LEAST_BOXES,
    SHIFTS_S,
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


@dataclass(frozen=True)
class LabelMistake:
    """Mistake that boxes may have. Undone, columns in `order` are multiplied by `factor`, and
    `turn` (rad) is added to yaw. axes: True if it depends on the frame's axes."""

    name: str
    remedy: str
    axes: bool = False
    order: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6)
    factor: tuple[int | float, ...] = (1, 1, 1, 1, 1, 1, 1)
    turn: float = 0.0

    def undo(self, boxes: BoxRows) -> BoxRows:
        """Boxes without the mistake."""
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

_MIRROR_X = "negate x, and take 180 degrees minus yaw"
_SWAP = "swap x and y, and take 90 degrees minus yaw"
_HALVED = "half extents where full ones belong: the boxes are half as large"
_DOUBLED = "doubled extents: the boxes are twice as large"
_HALF = (1, 1, 1, 0.5, 0.5, 0.5, 1)
_ACROSS = "length and width swapped, or yaw a quarter turn off"
_ADD_QUARTER = "swap length and width, or add 90 degrees to yaw"
_RADIANS = "yaw in radians where degrees belong"
_TO_DEGREES = (1, 1, 1, 1, 1, 1, 180 / np.pi)
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
    """Undo a mistake made in another frame, of boxes (world)."""
    if np.array_equal(frame_SE3_world, np.eye(4)):
        return mistake.undo(boxes)
    own = mistake.undo(records.move_boxes(frame_SE3_world, boxes))
    return records.move_boxes(invert(frame_SE3_world), own)


def degrees_of_turns(yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "k n"]:
    """All headings (rad, half a turn alike) that, in degrees and taken for radians, point along
    `yaw`. A file that stores sine and cosine, or a quaternion, of a wrong angle has lost its full
    turns."""
    turns = np.arange(-15, 16)[:, None]  # of 2 pi "degrees" each: a quarter turn either way
    return np.deg2rad(np.mod(yaw, 2 * np.pi)[None] + 2 * np.pi * turns)


MOST_SAMPLES = 3  # frames; tried delays where clouds have no times
STANDING = 0.2  # m between frames; an object that moves less stands still
ALONG = 0.7  # cosine between heading and way: above this the two agree
LEAST_TRACKS = 2  # tracks that must need the undoing to head along their way


class Shift(NamedTuple):
    """Delay of labels in words, fits with and without it."""

    amount: str
    behind: bool
    before: Float64[np.ndarray, " n"]
    after: Float64[np.ndarray, " n"]


def find_shift(some: Sequence[Seen]) -> Shift | None:
    """Find the delay of labels, None if it cannot be told. Moving labels are moved along their
    tracks. Where that shows nothing, labels are tried in other clouds; only those that are not in
    the same place in both frames count."""
    from scipy.spatial import cKDTree

    samples = [each.sample for each in some]
    movers = [find_movers(samples, k) for k in range(len(some))]

    def measure_shifted_fits(shift: float) -> np.ndarray:
        return fits(
            some,
            [boxes + np.column_stack([shift * v, np.zeros((len(v), 5))]) for boxes, v, _ in movers],
        )

    if sum(len(boxes) for boxes, *_ in movers) >= LEAST_BOXES:
        now = measure_shifted_fits(0.0)
        shifted = {
            sign * seconds: measure_shifted_fits(sign * seconds)
            for seconds in SHIFTS_S
            for sign in (1, -1)
        }
        best = max(shifted, key=lambda each: shifted[each].mean())
        if better(now, shifted[best]):
            return Shift(f"{abs(best):g} s", best > 0, now, shifted[best])
    found: Shift | None = None
    for places in [sign * k for k in range(1, MOST_SAMPLES + 1) for sign in (1, -1)]:
        pairs = [
            (some[k], some[k + places]) for k in range(len(some)) if 0 <= k + places < len(some)
        ]
        own = []
        there = []
        for labels, cloud in pairs:
            to_cloud = invert(cloud.sample.map_SE3_world) @ labels.sample.map_SE3_world
            boxes = records.move_boxes(to_cloud, labels.sample.objects.boxes)
            others = cloud.sample.objects.boxes
            # those farther than `STANDING` from all labels of that cloud
            moving = np.ones(len(boxes), bool)
            if len(boxes) and len(others):
                moving = np.asarray(cKDTree(others[:, :3]).query(boxes[:, :3])[0] > STANDING)
            own.append(labels.sample.objects.boxes[moving])
            there.append(boxes[moving])
        before = fits([labels for labels, _ in pairs], own)
        after = fits([cloud for _, cloud in pairs], there)
        gain = -np.inf if found is None else found.after.mean() - found.before.mean()
        if better(before, after) and after.mean() - before.mean() > gain:
            found = Shift(
                f"{abs(places)} sample{'s' * (abs(places) > 1)}", places < 0, before, after
            )
    return found


def against_their_way(
    samples: Sequence[Frame], undo: Callable[..., np.ndarray]
) -> tuple[int, int, int] | None:
    """Count tracks and moving boxes that only a mistake turns backwards, and all moving boxes."""
    tracks: set[int] = set()
    mended = spoilt = total = 0
    for k, sample in enumerate(samples):
        boxes, velocities, ids = find_movers(samples, k)
        ways = velocities / np.maximum(np.linalg.norm(velocities, axis=1, keepdims=True), 1e-9)
        yaws = (rows[:, 6] for rows in (boxes, undo(sample, boxes)))
        before, after = (np.cos(yaw) * ways[:, 0] + np.sin(yaw) * ways[:, 1] for yaw in yaws)
        turned = (before < 0) & (after > ALONG)
        tracks |= set(ids[turned].tolist())
        mended = mended + int(turned.sum())
        total = total + len(boxes)
        spoilt += int(((before > ALONG) & (after < 0)).sum())
    if len(tracks) < LEAST_TRACKS or mended < LEAST_BOXES or spoilt > mended / 10:
        return None
    return len(tracks), mended, total


MAX_EMPTY_SHARE = 0.5  # labels without a point
EXPLAINED_EMPTY_SHARE = 0.2
SUNK = 0.3  # fraction of its height that the median box may be off its place above the ground
ALIKE = 0.04  # difference in mean fit within which the first mistake in the list is named
TURNED_TOO_FAR = 0.2  # share of yaws beyond a full turn that is suspected
_UNIT = "check their unit, metres are read"
# remedies of what no sound recording has
_ALIKE = "name clouds and labels alike, times in the same unit"
_REMEDIES = {records.STRAY: _ALIKE, records.NOT_FINITE: "restore them, or remove them"}
_REMEDIES |= {
    records.NO_SIZE: _UNIT,
    records.TOO_LARGE: _UNIT,
    AWAY: "check their unit, and the frame they are in",
}
_REMEDIES |= {records.TILTED: "check the order of quaternions, w first or last, and of angles"}
_REMEDIES |= {
    records.EMPTY: "check their sensor, or leave these frames out",
    records.FAR_POINTS: _UNIT,
}
MIN_OFFSET_M = 0.3  # of labels from the points
MAX_OFFSET_M = 5.0
OFFSET_REACH_M = 2.0  # around a box in which its points may be
OFFSET_ROUNDS = 4
FREER = 0.1  # gain in mean fit that explanations which choose a sensor for each box need
MIN_CERTAIN_FIT_SHARE = 0.3  # mean fit below which the best explanation hardly explains the labels
TURNED_GAIN = 0.15  # gain in mean fit that explanations which turn each box freely need


@dataclass(frozen=True)
class Diagnosis:
    """Findings of the doctor, and the word where none is."""

    findings: list[Finding]
    healthy: str = "nothing suspected"


def diagnose(
    path: str | Path, layout: str | None = None, *, site: Site | None = None, frames: int = 20
) -> Diagnosis:
    """Check a recording for the classic mistakes.

    Raises what opening a recording of clouds raises. Files of images are checked as they are stored
    (`toolkit.datasets.doctor`). Labels of clouds are checked by how the points of the first frames
    lie in them."""
    if (layout or guess_layout(path)) == "hdf5":
        try:
            clouds = Path(path).is_file() and holds_clouds(path)
        except (OSError, ValueError):
            clouds = False  # the file's own doctor says what is wrong
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
    """Return what looks wrong with the sensors of a sound file of images, one against another."""
    try:
        recording = open_recording(path, "hdf5", site=site)
    except UnknownSite:  # points are compared with boxes in the site's frame
        return []
    samples = list(Part(recording, frames))
    return diagnose_sensors(
        [Seen.of(sample) for sample in samples], timely=not diagnose_times(samples)
    )


def find_impossible(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find labels that cannot be, as reading counted them, and times that cannot follow each
    other."""
    problems = sum((Counter(each.problems) for each in samples), Counter[str]())
    total = sum(len(each.objects) for each in samples)
    if all(len(each.objects) for each in samples):
        problems.pop(records.STRAY, None)  # a part of a recording beside the labels of all of it
    for kind, remedy in _REMEDIES.items():
        if problems[kind]:
            where = "labels"
            beside = f"beside {total} labels that are read"
            if kind in (records.EMPTY, records.FAR_POINTS):
                where = "clouds"
                beside = f"in {len(samples)} frames"
            yield Finding("error", where, kind, f"{problems[kind]}, {beside}", remedy)
    yield from suspect_times(np.array([each.time for each in samples]))


def diagnose_labels(samples: Iterable[Frame]) -> list[Finding]:
    """Return what looks wrong with labels of consecutive frames."""
    return diagnose_boxes([Seen.of(sample) for sample in samples])


def diagnose_boxes(some: Sequence[Seen]) -> list[Finding]:
    """Return what looks wrong with labels of consecutive frames whose ground is known."""
    total = sum(len(each.sample.objects) for each in some)
    beyond = sum(each.sample.problems.get(records.FULL_TURNS, 0) for each in some)
    if beyond and beyond >= TURNED_TOO_FAR * total:
        evidence = f"{beyond} of {total} yaws are beyond a full turn in radians"
        return [
            Finding(
                "error",
                "labels",
                "yaw in degrees where radians belong",
                evidence,
                "multiply yaw by pi / 180",
            )
        ]
    boxes = [each.sample.objects.boxes for each in some]
    findings = list[Finding]()
    current = fits(some, boxes)
    best = _find_best(some, current)
    # a choice for each box explains an offset too
    is_free = best is not None and best.mistake is LOST_DEGREES
    best = _clearer(best, _find_offset(some, current), -FREER if is_free else ALIKE)
    if best is not None:
        findings.append(_finding(best.mistake.name, current, best.fits, best.mistake.remedy))
        boxes = best.boxes
    grounds = [
        (each.ground, own) for each, own in zip(some, boxes, strict=True) if each.ground is not None
    ]
    above = [(own[:, 2] - ground.height(own[:, :2])) / own[:, 5] for ground, own in grounds]
    # heights of centres above the ground, in heights of their boxes
    shares = np.concatenate([np.zeros(0), *above])
    share = float(np.median(shares)) if len(shares) >= LEAST_BOXES else 0.5
    if abs(share - 0.5) >= SUNK:
        side, remedy = (
            ("floor", "add half the height to z")
            if share < 0.5
            else ("roof", "take half the height off z")
        )
        where = f"the centre of the {side} where the centre of the box belongs"
        height = (
            f"the stored centres stand {share:.0%} of the boxes' heights above the ground, median "
            f"of {len(shares)}"
        )
        findings.append(Finding("error", "labels", where, height, remedy))
    if findings:
        return findings
    empty = [*suspect_empty(some)]
    if empty:
        return empty
    shift = find_shift(some)
    if shift is not None:
        name = (
            f"labels lie about {shift.amount} {'behind' if shift.behind else 'ahead of'} the clouds"
        )
        remedy = (
            f"move labels by {'+' if shift.behind else '-'}{shift.amount} along their way, or "
            "pair other clouds"
        )
        return [_finding(name, shift.before, shift.after, remedy)]
    turned = _turn_each(some)
    if better(current, turned.fits, TURNED_GAIN):
        return [_finding(LOST_DEGREES.name, current, turned.fits, LOST_DEGREES.remedy)]
    samples = [each.sample for each in some]
    ways = (
        lambda _, boxes: YAW_SIGN.undo(boxes),
        lambda sample, boxes: undo_mistake(YAW_SIGN, boxes, sample.map_SE3_world),
    )
    for undo in ways:
        headed = against_their_way(samples, undo)
        if headed is not None:
            tracks, against, total = headed
            evidence = (
                f"{against} of {total} boxes that move, of {tracks} objects, head against their "
                "way, "
            )
            evidence += "and along it with that undone"
            return [Finding("error", "labels", YAW_SIGN.name, evidence, YAW_SIGN.remedy)]
    return []


class OtherFrame(NamedTuple):
    """Mistake of labels that are in another frame than the world, and their boxes in the world if
    it was made."""

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


def suspect_empty(some: Sequence[Seen]) -> Iterator[Finding]:
    """Find labels that mostly hold no point of any sensor, and the frame in which they would."""
    empty, total = _count_empty(some, [each.sample.objects.boxes for each in some])
    if not total or empty / total <= MAX_EMPTY_SHARE:
        return
    counted = f"{empty} of {total} boxes hold no point above the ground"
    samples = [each.sample for each in some]
    undone = [_undo_each(wrong.mistake, some, wrong.choose) for wrong in other_frames(samples)]
    best = max(undone, key=lambda attempt: float(attempt.fits.mean()))
    left, _ = _count_empty(some, best.boxes)
    if left / total <= EXPLAINED_EMPTY_SHARE:
        evidence = f"{counted}, {left} with that undone"
        yield Finding("error", "labels", best.mistake.name, evidence, best.mistake.remedy)
        return
    remedy = (
        "check the frame and unit of labels, the poses of sensors, and that labels and clouds "
        "belong together"
    )
    yield Finding("warning", "labels", "boxes without a point from any sensor", counted, remedy)


def _count_empty(some: Sequence[Seen], boxes: Sequence[BoxRows]) -> tuple[int, int]:
    """Count boxes without a point above the ground, and all boxes."""
    counts = [
        count_points(each.points, own) for each, own in zip(some, boxes, strict=True) if len(own)
    ]
    inside = np.concatenate([np.zeros(0, np.int64), *counts])
    return int((inside == 0).sum()), len(inside)


class _Undone(NamedTuple):
    """Mistake, the boxes without it, and their fits."""

    mistake: LabelMistake
    boxes: list[np.ndarray]
    fits: np.ndarray


def _find_best(some: Sequence[Seen], current: np.ndarray) -> _Undone | None:
    """Find the mistake whose undoing raises the fits most; choices for each box must fit clearly
    better."""

    def undo(mistake: LabelMistake, frames: Callable[[Frame], Sequence[np.ndarray]]) -> _Undone:
        def choose(sample: Frame) -> list[np.ndarray]:
            return [undo_mistake(mistake, sample.objects.boxes, frame) for frame in frames(sample)]

        return _undo_each(mistake, some, choose)

    def in_sensors(sample: Frame) -> list[np.ndarray]:
        return [invert(cloud.world_SE3_sensor) for cloud in sample.clouds] or [np.eye(4)]

    in_axes = [mistake for mistake in LABEL_MISTAKES if mistake.axes]
    samples = [each.sample for each in some]
    frames = [_undo_each(wrong.mistake, some, wrong.choose) for wrong in other_frames(samples)]
    attempts = [undo(mistake, lambda _: [np.eye(4)]) for mistake in LABEL_MISTAKES]
    if any(not np.allclose(each.sample.map_SE3_world, np.eye(4)) for each in some):
        attempts += [undo(mistake, lambda sample: [sample.map_SE3_world]) for mistake in in_axes]
    plain = _find_most([*attempts, *frames], current)
    best = _clearer(
        plain, _find_most([undo(mistake, in_sensors) for mistake in in_axes], current, FREER), FREER
    )
    return (
        best
        if best is None
        else _clearer(best, _turn_each(some), TURNED_GAIN if best is plain else FREER)
    )


def _find_most(attempts: Sequence[_Undone], current: np.ndarray, *gain: float) -> _Undone | None:
    surer = [attempt for attempt in attempts if better(current, attempt.fits, *gain)]
    means = _means(surer) if surer else []
    return next(
        (attempt for attempt, mean in zip(surer, means, strict=True) if mean >= max(means) - ALIKE),
        None,
    )


def _clearer(best: _Undone | None, freer: _Undone | None, margin: float) -> _Undone | None:
    """Return the freer explanation if it wins by a margin."""
    if best is None or freer is None:
        return best or freer
    one, other = _means([best, freer])
    return freer if other > one + margin else best


def _means(attempts: Sequence[_Undone]) -> list[float]:
    """Mean fit under each explanation, over the same boxes."""
    known = np.any([attempt.fits > 0 for attempt in attempts], axis=0)
    return [float(attempt.fits[known].mean()) for attempt in attempts]


def _find_offset(some: Sequence[Seen], current: Float64[np.ndarray, " n"]) -> _Undone | None:
    """Find one horizontal offset of all labels from the points, None if undoing it does not fit
    better."""
    boxes = [each.sample.objects.boxes for each in some]
    offset = np.zeros(2)
    for _ in range(OFFSET_ROUNDS):
        moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
        away = [_measure_offsets(each.points, rows) for each, rows in zip(some, moved, strict=True)]
        known = np.concatenate([np.zeros((0, 2)), *away])
        if len(known) < LEAST_BOXES:
            return None
        offset = offset - np.median(known, axis=0)
    moved = [rows - np.array([*offset, 0, 0, 0, 0, 0]) for rows in boxes]
    if not MIN_OFFSET_M <= np.hypot(*offset) <= MAX_OFFSET_M:
        return None
    undone = fits(some, moved)
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
    """Places of the points around boxes from the boxes' centres, of those that have some."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(boxes):
        return np.zeros((0, 2))
    tree = cKDTree(points[:, :2])
    near = tree.query_ball_point(
        boxes[:, :2], np.hypot(boxes[:, 3], boxes[:, 4]) / 2 + OFFSET_REACH_M
    )
    rows = [
        np.median(points[found, :2], axis=0) - box[:2]
        for found, box in zip(near, boxes, strict=True)
        if found
    ]
    return np.array(rows).reshape(-1, 2)


def _turn_each(some: Sequence[Seen]) -> _Undone:
    def turn(sample: Frame) -> list[np.ndarray]:
        rows = sample.objects.boxes
        return [np.column_stack([rows[:, :6], yaw]) for yaw in degrees_of_turns(rows[:, 6])]

    return _undo_each(LOST_DEGREES, some, turn)


def _undo_each(
    mistake: LabelMistake, some: Sequence[Seen], choose: Callable[[Frame], Sequence[np.ndarray]]
) -> _Undone:
    """Take the best-fitting choice for every box."""
    boxes = []
    for each in some:
        choices = choose(each.sample)
        best = (
            np.argmax([measure_fits(each.points, own) for own in choices], axis=0)
            if len(choices) > 1
            else 0
        )
        boxes.append(np.stack(choices)[best, np.arange(len(choices[0]))])
    return _Undone(mistake, boxes, fits(some, boxes))


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
