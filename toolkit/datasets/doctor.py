"""Doctor of stored images: suspicious sensors and objects.

A sensor is frozen if an image repeats an earlier one although its objects have left, and blind if
it returns far less than usual while other sensors do not.

Suspected mistakes in a recording's conventions: each classic mistake is undone and the fits are
compared. The evidence is motion. Sensors do not move, so a pixel that is nearer than in other
frames shows an object. Points of such pixels must be on the objects' boxes: inside them, and near
their surface rather than in their core. `fit` is the share of moving points that are. A mistake is
suspected if undoing it raises the fit clearly."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Literal, NamedTuple

import h5py
import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Pose
from toolkit.boxes import count_points, iou_bev
from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset, UnknownSite, check_kinds, object_rows, open_file
from toolkit.geometry import invert, level_rows, transform
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.points import count_on_ground
from toolkit.runtime import hdf5
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

MIN_OBJECT_POINTS = 20  # points that show an object
USUAL_QUANTILE = 0.9  # of the number of returns, which counts as usual
MAX_BLIND_SHARE = 0.5  # share of the usual number of returns below which a sensor is blind
UNKNOWN_SITE = "somewhere"  # name of a site whose detection area is unknown
MAX_CHECKED_FRAMES = 60  # evenly spread over the file
MIN_SENSOR_FIT = 0.5  # share of a sensor's moving points on boxes, for its pose to be certain
MIN_INSIDE_SHARE = 0.01  # share of a sensor's points in the detection area, if it sees the area
MAX_UNSEEN_SHARE = 0.3  # share of the objects in the area without a point
MAX_FLOATING_M = 0.25  # between a box's floor and the ground
_UNITS = {
    0.01: "centimetres",
    0.001: "millimetres",
    published.NO_RETURN_M: "parts of the far plane, 0 to 1",
}
MIN_FRAME_STEP_S = 1e-3  # from frame to frame
MAX_FRAME_STEP_S = 300.0  # from frame to frame
MIN_CLEAR_GAIN = 0.05  # in fit, for a suspicion of a mistake
MIN_EXPLAINED_FIT = 0.6  # without the mistake
MIN_MOVING_POINTS = 200  # with fewer nothing is suspected
_MOVED_M = 0.3  # nearer than the empty scene
_SLACK_M = 0.1  # that a point may be outside its box
_CORE_SHARE = 0.6  # share of a vehicle's box in which a sensor sees nothing
_POINTS_PER_FRAME = 100  # for each sensor
# axes x right, y down, z forward
_FORWARD_FIRST = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
Rows = Float64[np.ndarray, "_ 10"]
_COLUMNS = ("x", "y", "z", "pitch", "roll", "yaw", "l", "w", "h", "label")
_FULL = "full extents stored where half extents belong: the boxes are twice too large"
_HALVED = "half of the half extents stored: the boxes are half as large as their objects"
_RADIANS = "yaw in radians where degrees belong"
_TWICE = "yaw turned from radians to degrees twice"
_NEGATE_YAW = "negate column 5 of objects: CARLA's y points the other way, so does its yaw"
MIRROR_Y = "negate columns 1 (y) and 5 (yaw) of objects"
_MIRRORED = "mirrored y axis: a right-handed world where CARLA's left-handed one belongs"
_MIRROR_X = "negate column 0 (x) of objects and take 180 degrees minus column 5 (yaw)"
_SWAP = "swap columns 0 and 1 of objects and take 90 degrees minus column 5 (yaw)"
_END = (
    "the centre of the {} stored where the centre of the box belongs: the boxes {} by half their "
    "height"
)
_ADD = "add column 8 (half height) to column 2 (z) of objects"
_SUBTRACT = "subtract column 8 (half height) from column 2 (z) of objects"
_FOR_ANOTHER = "its extrinsic is for a right-handed world and a camera with"
_SENSOR_MISTAKES = {  # with their remedies
    "its extrinsic is camera → world, the inverse of what belongs there": (
        "store the inverse of extrinsic"
    ),
    f"{_FOR_ANOTHER} x right, y down, z forward": (
        "turn extrinsic into CARLA's world (y negated) and a camera with X forward, Y right, Z up"
    ),
    f"{_FOR_ANOTHER} x forward, y left, z up": (
        "negate y of the world and of the camera in extrinsic"
    ),
    "its depth is the distance along the ray, not along the optical axis": (
        "divide each depth by the length of its ray whose X is 1"
    ),
    "it looks away: in the opposite direction": (
        "turn extrinsic by 180 degrees about the camera's Z"
    ),
}
MAX_FRAMES_OFF = 3
MIN_SHIFT_GAIN = 0.2  # in fit, for a suspicion of shifted frames


def frozen_frames(
    view: "SensorImages", rows: "Sequence[Rows]", site: Site
) -> Bool[np.ndarray, " frames"]:
    """Mask of frames in which a sensor repeats an image whose objects have left.

    rows: published rows by frame."""
    frozen = np.zeros(len(view.depth), bool)
    first = 0
    for k in range(1, len(view.depth)):
        if not (view.depth[k].any() and np.array_equal(view.depth[k], view.depth[k - 1])):
            first = k
            continue
        before = published.parse_rows(rows[first], site.map_SE3_site)
        now = published.parse_rows(rows[k], site.map_SE3_site)
        gone = before.boxes[~(iou_bev(before.boxes, now.boxes) > 0).any(axis=1)]
        frozen[k] = bool((count_points(view.points(k), gone) >= MIN_OBJECT_POINTS).any())
    return frozen


def blind_frames(views: "Sequence[SensorImages]") -> Bool[np.ndarray, "sensors frames"]:
    """Mask of the frames in which a sensor has far fewer returns than usual, while others do
    not."""
    returned = np.array([(view.depth > 0).sum(axis=1) for view in views])
    blind = returned < MAX_BLIND_SHARE * np.quantile(returned, USUAL_QUANTILE, axis=1)[:, None]
    return np.asarray(blind & ~blind.all(axis=0))


def failing_sensors(
    views: "Sequence[SensorImages]", rows: "Sequence[Rows]", site: Site, frames: Sequence[int]
) -> Iterator[tuple[str, str, str, str]]:
    """Yield location, suspicion, evidence and remedy per failing sensor. frames: numbers of the
    images."""
    if not views or not frames:
        return
    for view, is_blind in zip(views, blind_frames(views), strict=True):
        is_frozen = frozen_frames(view, rows, site)
        for is_failing, suspected, evidence in (
            (is_frozen, "it is frozen", "show objects where nobody is any more"),
            (
                is_blind,
                "it goes blind",
                "return less than half of what is usual, other sensors see as ever",
            ),
        ):
            if is_failing.any():
                first = f"the first is {frames[int(is_failing.argmax())]},"
                observation = (
                    f"{int(is_failing.sum())} of {len(frames)} frames that were looked at, {first} "
                    f"{evidence}"
                )
                yield (
                    f"sensor {view.sensor.name}",
                    suspected,
                    observation,
                    "leave these frames out, or the sensor",
                )


@dataclass(frozen=True)
class Finding:
    """One suspicion.

    Attributes:
        severity: error or warning.
        where: dataset, sensor or frame of the file.
        suspected: the suspicion in words.
        evidence: the numbers behind it.
        remedy: what to do about it.
    """

    severity: Literal["error", "warning"]
    where: str
    suspected: str
    evidence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.suspected} ({self.evidence}); {self.remedy}"


_error = partial(Finding, "error")


def check_measurements(
    dataset: CoopDataset, tables: Sequence[np.ndarray], units: Sequence[float] = (1.0,)
) -> list[Finding]:
    """Check some of the frames.

    tables: the published rows of all frames; units: factors that may turn depth into metres; the
    factor is taken that makes points and boxes agree best."""
    frames = np.unique(
        np.linspace(0, len(dataset) - 1, min(len(dataset), MAX_CHECKED_FRAMES)).astype(int)
    ).tolist()
    raw, findings = _views(dataset, frames)
    # only dslices is in doubt
    shared = [channel.depth_index is not None for channel in dataset.channels]
    examined = []
    for unit in units:
        views = []
        for view, doubt in zip(raw, shared, strict=True):
            metres = view.depth * np.float32(unit if doubt else 1.0)
            far = min(view.sensor.model.max_range, published.NO_RETURN_M)
            views.append(replace(view, depth=np.where(metres < far * 0.999, metres, np.float32(0))))
        examined.append(_Examination(dataset.site, views, tables, frames))
    best = max(range(len(units)), key=lambda i: examined[i].explained)
    if units[best] != 1:
        largest = max(
            float(view.depth.max(initial=0))
            for view, doubt in zip(raw, shared, strict=True)
            if doubt
        )
        evidence = (
            f"the largest number is {largest:g}, the far plane lies at {published.NO_RETURN_M:g} m"
        )
        words = f"depth in {_UNITS.get(units[best], 'another unit')} instead of metres"
        findings.append(_error("dslices", words, evidence, f"multiply by {units[best]:g}"))
    exam = examined[best]
    findings += [*_no_points(exam.views, frames), *exam.disagreements()]
    findings += [*_posture(exam), *_ground(exam), *_unseen(exam)]
    failing = failing_sensors(exam.views, exam.rows, dataset.site, frames)
    return findings + [Finding("warning", *finding) for finding in failing]


class _Examination:
    """Agreement of points and boxes, with and without the suspected mistakes."""

    def __init__(
        self,
        site: Site,
        views: "Sequence[SensorImages]",
        tables: Sequence[np.ndarray],
        frames: Sequence[int],
    ) -> None:
        self.site = site
        self.views = views
        sensors = [view.sensor for view in views]
        pixels = witnesses(views)
        clouds = collect_clouds(pixels, sensors, len(frames))
        other_frames, rows = suspect_frames(clouds, tables, frames, site.map_SE3_site)
        undone = suspect_objects(pixels, sensors, rows, site.map_SE3_site)
        self.mistakes = [other_frames] if other_frames else []
        self.mistakes += undone.suspicions
        self.explained = undone.fit * sum(len(witness.depth) for witness in pixels)
        self.misplaced, self.rows = _misplaced(undone.rows, site)
        self.doubts: dict[str, Suspicion | None] = {}
        self.fits: dict[str, float] = {}
        for i, sensor in enumerate(sensors):
            sensor_witnesses = [witness for witness in pixels if witness.sensor == i]
            count = sum(len(witness.depth) for witness in sensor_witnesses)
            if count < MIN_MOVING_POINTS or not any(len(table) for table in self.rows):
                continue
            suspicion, sensor_fit = suspect_sensor(
                sensor_witnesses, sensor, self.rows, site.map_SE3_site
            )
            self.fits[sensor.name] = sensor_fit
            if suspicion is not None or sensor_fit < MIN_SENSOR_FIT:
                self.doubts[sensor.name] = suspicion

    def disagreements(self) -> Iterator[Finding]:
        """Yield suspected mistakes: objects first, then sensors."""
        for mistake in self.mistakes:
            yield _error("objects", mistake.mistake, mistake.evidence, mistake.remedy)
        yield from self.misplaced
        kinds = dict.fromkeys(suspicion and suspicion.mistake for suspicion in self.doubts.values())
        for kind in kinds:
            doubts = {
                name: suspicion
                for name, suspicion in self.doubts.items()
                if (suspicion and suspicion.mistake) == kind
            }
            where = f"sensor{'s' * (len(doubts) > 1)} {', '.join(doubts)}"
            evidence = self._evidence(doubts)
            first = next(iter(doubts.values()))
            if first is not None:
                yield _error(where, first.mistake, evidence, first.remedy)
            else:
                remedy = "check the pose, and that images and objects belong to the same frames"
                yield _error(where, "points and boxes disagree", evidence, remedy)

    def _evidence(self, doubts: "Mapping[str, Suspicion | None]") -> str:
        """Fits of the sensors in doubt, each under its name if there are several."""
        words = {
            name: f"{self.fits[name]:.0%} of the moving points lie on boxes"
            if doubt is None
            else doubt.evidence
            for name, doubt in doubts.items()
        }
        if len(words) == 1:
            return next(iter(words.values()))
        return "; ".join(f"{name}: {evidence}" for name, evidence in words.items())

    def clouds(self) -> Iterator[tuple[Objects, np.ndarray]]:
        """Yield objects and points of some frames, site frame. Sensors in doubt are left out."""
        trusted = [view for view in self.views if view.sensor.name not in self.doubts]
        for frame in range(0, len(self.rows), max(1, len(self.rows) // 20)):
            points = [np.zeros((0, 3), np.float32), *(view.points(frame) for view in trusted)]
            yield (
                published.parse_rows(self.rows[frame], self.site.map_SE3_site),
                np.concatenate(points),
            )


def _views(
    dataset: CoopDataset, frames: Sequence[int]
) -> "tuple[list[SensorImages], list[Finding]]":
    """Measurements of some frames as stored, in any unit.

    Frames that cannot be read become findings."""
    views = []
    findings = []
    for sensor, name, index, stride in dataset.channels:
        images = dataset.stored(name)
        depth = np.zeros((len(frames), *sensor.model.shape), np.float32)
        for i, k in enumerate(frames):
            try:
                image = hdf5.rows(images, name, k if index is None else (k, index))
            except OSError as error:
                findings.append(
                    _error(f"{name}, frame {k}", "damaged image", str(error), "restore the file")
                )
                continue
            with np.errstate(over="ignore"):
                depth[i] = image[::stride, ::stride]
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
        views.append(
            SensorImages(sensor, sensor.model.rays().reshape(-1, 3), depth.reshape(len(frames), -1))
        )
    return views, findings


def _no_points(views: "Sequence[SensorImages]", frames: Sequence[int]) -> Iterator[Finding]:
    """Find sensors that never see anything, and frames in which no sensor does."""
    blind = [view.sensor.name for view in views if not view.depth.any()]
    for name in blind:
        remedy = "check its images and their unit, or leave it out"
        yield _error(
            f"sensor {name}", "no points", f"not one pixel of {len(frames)} frames returned", remedy
        )
    has_points = np.zeros(len(frames), bool)
    for view in views:
        has_points |= view.depth.any(axis=1)
    dark = [k for i, k in enumerate(frames) if not has_points[i]]
    if dark and len(blind) < len(views):
        evidence = (
            f"{len(dark)} of {len(frames)} frames that were looked at, the first is {dark[0]}"
        )
        yield _error(
            f"frame {dark[0]}",
            "frames without points",
            evidence,
            "restore their images or leave them out",
        )


def _posture(exam: _Examination) -> Iterator[Finding]:
    """Find sensors under the ground, upside down, or facing away from the detection area.

    Sensors whose pose is explained otherwise are skipped."""
    site = exam.site
    for view in exam.views:
        sensor = view.sensor
        where = f"sensor {view.sensor.name}"
        if exam.doubts.get(sensor.name) is not None:
            continue
        ahead = sensor.world_SE3_body[:2, 0]
        up = sensor.world_SE3_body[2, 2]
        height = float(sensor.position[2] - site.ground(sensor.position[:2]))
        if height < 0:
            yield _error(
                where,
                "it stands under the ground",
                f"height {height:.2f} m",
                "check z and signs of its pose",
            )
        if up < -0.1:
            yield _error(
                where,
                "it hangs upside down",
                f"its up has z {up:.2f}",
                "check the signs in its pose",
            )
        points = np.concatenate([view.points(frame) for frame in range(min(len(view.depth), 5))])
        inside = _in_area(points[:, :2], site)
        if len(points) and site.name != UNKNOWN_SITE and inside.mean() < MIN_INSIDE_SHARE:
            to_centre = (site.area[:2] + site.area[2:]) / 2 - sensor.position[:2]
            turn = np.rad2deg(
                np.arctan2(ahead[0] * to_centre[1] - ahead[1] * to_centre[0], ahead @ to_centre)
            )
            left = f"whose centre lies {turn:.0f} degrees to its left"
            evidence = f"{inside.mean():.1%} of its points in the area, {left}"
            yield _error(
                where,
                "it looks away from the detection area",
                evidence,
                "check its heading and the area",
            )


def _misplaced(rows: list[np.ndarray], site: Site) -> tuple[list[Finding], list[np.ndarray]]:
    """Find objects outside the site, perhaps by a mirrored axis.

    Returns the rows without that mistake too."""
    centres = np.concatenate([np.zeros((0, 3)), *(table[:, :3] for table in rows)])
    flips = {"": np.ones(10), "y": np.array([1.0, -1, 1, 1, 1, -1, 1, 1, 1, 1])}
    site_from_carla = np.linalg.inv(published.MAP_FROM_CARLA @ site.map_SE3_site)
    nearby = dict.fromkeys(flips, 1.0)  # share within 15 m of the area
    for axis, flip in flips.items() if len(centres) else ():
        places = transform(site_from_carla, centres * flip[:3])
        nearby[axis] = float(_in_area(places[:, :2], site, margin=15.0).mean())
    if nearby[""] >= 0.5 or site.name == UNKNOWN_SITE:
        return [], rows
    evidence = f"{nearby['']:.0%} of {len(centres)} objects in or near the area of {site.name!r}"
    if nearby["y"] < 0.5:
        remedy = "pass the site where this was recorded, or check the coordinates"
        return [_error("objects", "objects elsewhere than the site", evidence, remedy)], rows
    evidence += f", {nearby['y']:.0%} with y negated"
    return [_error("objects", "mirrored y axis", evidence, MIRROR_Y)], [
        table * flips["y"] for table in rows
    ]


def _ground(exam: _Examination) -> Iterator[Finding]:
    """Find boxes whose floor is off the ground around them."""
    gaps = []
    for objects, cloud in exam.clouds():
        points = level_rows(cloud[::4], exam.site.relief.slope)
        for x, y, z, length, width, height, _ in level_rows(objects.boxes, exam.site.relief.slope):
            away = np.hypot(points[:, 0] - x, points[:, 1] - y)
            beside = points[
                (away > np.hypot(length, width) / 2) & (away < np.hypot(length, width) / 2 + 2), 2
            ]
            if len(beside) >= 20:
                gaps.append(z - height / 2 - np.percentile(beside, 10))
    if len(gaps) >= 10 and abs(np.median(gaps)) > MAX_FLOATING_M:
        gap = float(np.median(gaps))
        word, side = ("float above", "above") if gap > 0 else ("are sunk into", "below")
        evidence = f"their floor is {abs(gap):.2f} m {side} it, median of {len(gaps)} boxes"
        remedy = f"add {-gap:.2f} m to column 2 (z) of objects"
        yield _error("objects", f"the boxes {word} the ground", evidence, remedy)


def _unseen(exam: _Examination) -> Iterator[Finding]:
    """Find objects in the area without a point, if they are too many to be hidden."""
    counts = [np.zeros(0, np.int64)]  # points on each object
    for objects, points in exam.clouds() if exam.site.name != UNKNOWN_SITE else ():
        if len(points):
            inside = objects[_in_area(objects.boxes[:, :2], exam.site)]
            counts.append(count_on_ground(points, inside.boxes, exam.site))
    unseen = np.concatenate(counts) == 0
    if len(unseen) >= 10 and unseen.mean() > MAX_UNSEEN_SHARE:
        evidence = f"{unseen.sum()} of {len(unseen)} objects in the detection area"
        remedy = "check poses and boxes, and that images and objects belong to the same frames"
        yield Finding(
            "warning", "objects", "objects without a point from any sensor", evidence, remedy
        )


def _in_area(xy: np.ndarray, site: Site, margin: float = 0.0) -> np.ndarray:
    inside: np.ndarray = (xy >= site.area[:2] - margin) & (xy <= site.area[2:] + margin)
    return np.asarray(inside.all(axis=1))


def diagnose_file(path: str | Path, site: Site | None = None) -> list[Finding]:
    """Diagnose a dataset, ours or a published one; no findings for a healthy one.

    All tables of objects are checked, and the measurements of some frames. Raises FileNotFoundError
    for a missing file; all other damage is a finding."""
    try:
        with open_file(path) as file:
            check_kinds(file)
            units = _depth_units(file)
            stored = _tables(file)
        try:
            dataset = CoopDataset(path, site)
        except UnknownSite:  # any site serves to check the file
            dataset = CoopDataset(path, Site(UNKNOWN_SITE, np.array([-1.0, -1, 1, 1])))
        with dataset:
            if not len(dataset):
                remedy = "record some, or restore the file"
                return [_error("dslices", "no frames", "it has 0 frames", remedy)]
            findings = stored.findings
            if dataset.times is not None:
                findings += suspect_times(dataset.times)
            findings += _repetitions(stored.tables, stored.is_readable)
            return findings + check_measurements(dataset, stored.tables, units)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        return [_error(str(path), "it cannot be read", str(error), "repair it or restore it")]


def suspect_times(times: Float64[np.ndarray, " frames"]) -> Iterator[Finding]:
    """Find times of frames (s) that cannot follow each other."""
    steps = np.diff(times[np.isfinite(times)])
    back = int((steps <= 0).sum())
    if back > max(1, len(steps) / 10):  # a new scene or sensor may begin again
        evidence = f"{back} of {len(steps)} steps, the smallest of {steps.min():g} s"
        remedy = "check the times, or sort the frames"
        yield _error("frames", "times that repeat or go back", evidence, remedy)
    elif len(steps) and not MIN_FRAME_STEP_S < np.median(steps) < MAX_FRAME_STEP_S:
        evidence = f"{np.median(steps):g} s from frame to frame, median of {len(steps)}"
        words = "times in another unit than seconds"
        yield Finding("warning", "frames", words, evidence, "check the unit of the times")


def _depth_units(file: h5py.File) -> tuple[float, ...]:
    """Factors that may turn the file's depth into metres, by its largest number."""
    if not hdf5.contains(file, "dslices"):
        return (1.0,)
    images = hdf5.dataset(file, "dslices", kinds="fiub")
    if images.ndim != 4 or not len(images):
        return (1.0,)
    image = hdf5.rows(images, "dslices", len(images) // 2).astype(np.float64)
    largest = float(np.max(image, where=np.isfinite(image), initial=0.0))
    if 0 < largest <= 1.0:
        return (published.NO_RETURN_M,)  # CARLA's encoding, parts of the far plane
    if largest <= 1.01 * published.NO_RETURN_M:
        return (1.0,)
    return tuple(
        unit for unit in (1.0, 0.01, 0.001) if largest * unit <= 2 * published.NO_RETURN_M
    ) or (0.001,)


class _StoredTables(NamedTuple):
    """Published rows of all frames, which frames are readable, and findings."""

    tables: list[np.ndarray]
    is_readable: list[bool]
    findings: list[Finding]


def _tables(file: h5py.File) -> _StoredTables:
    """Read the objects of all frames; only the first three unreadable frames become findings."""
    images = [*hdf5.find_kinds(file, ("dslices", "coview/time"))]
    shape = hdf5.dataset(file, images[0], kinds="fiub").shape if images else ()
    tables: list[np.ndarray] = []
    faults: list[str] = []
    for k in range(shape[0] if shape else 0):
        table = np.zeros((0, len(published.OBJECT_COLUMNS)))
        fault = ""
        try:
            rows = object_rows(file, f"objects/{k}")
            words = published.wrong_rows(rows)
            published.parse_rows(rows[words == ""], np.eye(4))
            table = np.asarray(rows[words == ""], np.float64)
            if (words != "").any():
                fault = f"row {int((words != '').argmax())} {words[words != ''][0]}"
        except (ValueError, OSError) as error:
            fault = str(error).removeprefix("objects ")
        tables.append(table)
        faults.append(fault)
    damaged = [(f"objects/{k}", fault) for k, fault in enumerate(faults) if fault][:3]
    remedy = "repair or leave out the frame"
    findings = [_error(where, "damaged objects", fault, remedy) for where, fault in damaged]
    return _StoredTables(tables, [not fault for fault in faults], findings)


def _repetitions(tables: Sequence[np.ndarray], is_readable: Sequence[bool]) -> list[Finding]:
    """Find frames without objects, and frames that occur twice."""
    findings = []
    empty = [k for k, table in enumerate(tables) if is_readable[k] and not len(table)]
    if empty:
        evidence = f"{len(empty)} of {len(tables)} frames, the first is {empty[0]}"
        remedy = "right if nothing was there, else restore their objects"
        findings.append(
            Finding("warning", f"objects/{empty[0]}", "frames without objects", evidence, remedy)
        )
    first: dict[bytes, int] = {}
    twins = [
        (first.setdefault(table.tobytes(), k), k) for k, table in enumerate(tables) if len(table)
    ]
    twins = [(original, copy) for original, copy in twins if original != copy]
    if twins:
        evidence = (
            f"{len(twins)} of {len(tables)} frames, frame {twins[0][1]} has the objects of frame "
            f"{twins[0][0]}"
        )
        remedy = "leave the copies out, or they count twice in training and AP"
        findings.append(
            Finding("warning", f"objects/{twins[0][1]}", "duplicated frames", evidence, remedy)
        )
    return findings


@dataclass(frozen=True, eq=False)
class SensorImages:
    """Images of one sensor.

    rays: (pixels, 3), in its frame; depth: (frames, pixels), 0 for no return."""

    sensor: Sensor
    rays: Float32[np.ndarray, "pixels 3"]
    depth: Float32[np.ndarray, "frames pixels"]

    def moving(self) -> Bool[np.ndarray, "frames pixels"]:
        """Mask of the pixels that show a moving object, one that is missing in another frame."""
        # a frame without any return shows nothing of the scene
        seen = self.depth[(self.depth > 0).any(axis=1)]
        if len(seen) < 3:
            return np.zeros(self.depth.shape, bool)
        background = np.where(seen > 0, seen, np.inf).max(axis=0)
        return (self.depth > 0) & (self.depth < 100) & (self.depth < background * 0.99 - _MOVED_M)

    def points(self, frame: int) -> Float32[np.ndarray, "_ 3"]:
        """Points of one frame, site frame."""
        seen = self.depth[frame] > 0
        return transform(self.sensor.pose, self.rays[seen] * self.depth[frame, seen, None])


class Witness(NamedTuple):
    """Moving pixels of one sensor in one frame."""

    frame: int
    sensor: int
    rays: Float64[np.ndarray, "p 3"]
    depth: Float64[np.ndarray, " p"]


class Suspicion(NamedTuple):
    """A mistake whose undoing raises the fit."""

    mistake: str
    remedy: str
    before: float
    after: float

    @property
    def evidence(self) -> str:
        """Both fits in words."""
        return (
            f"{self.before:.0%} of the moving points lie on boxes as it is, {self.after:.0%} with "
            "that undone"
        )


class Mistake(NamedTuple):
    """A mistake in the objects. undo: from columns, by short names, to those that change."""

    mistake: str
    remedy: str
    undo: Callable[..., dict[str, np.ndarray]]


OBJECT_MISTAKES = (
    Mistake(_FULL, "halve columns 6 to 8 of objects", lambda o: {key: o[key] / 2 for key in "lwh"}),
    Mistake(
        _HALVED, "double columns 6 to 8 of objects", lambda o: {key: o[key] * 2 for key in "lwh"}
    ),
    Mistake(
        "length and width swapped",
        "swap columns 6 and 7 of objects",
        lambda o: {"l": o["w"], "w": o["l"]},
    ),
    Mistake(
        _RADIANS,
        "multiply column 5 of objects by 180 / pi",
        lambda o: {"yaw": np.rad2deg(o["yaw"])},
    ),
    Mistake(
        _TWICE, "multiply column 5 of objects by pi / 180", lambda o: {"yaw": np.deg2rad(o["yaw"])}
    ),
    Mistake("yaw counted the other way round", _NEGATE_YAW, lambda o: {"yaw": -o["yaw"]}),
    Mistake(
        "yaw a quarter turn off",
        "add 90 degrees to column 5 of objects",
        lambda o: {"yaw": o["yaw"] + 90},
    ),
    Mistake(_MIRRORED, MIRROR_Y, lambda o: {"y": -o["y"], "yaw": -o["yaw"]}),
    Mistake(
        "mirrored y axis, of the positions alone",
        "negate column 1 (y) of objects",
        lambda o: {"y": -o["y"]},
    ),
    Mistake("mirrored x axis", _MIRROR_X, lambda o: {"x": -o["x"], "yaw": 180 - o["yaw"]}),
    Mistake("x and y swapped", _SWAP, lambda o: {"x": o["y"], "y": o["x"], "yaw": 90 - o["yaw"]}),
    Mistake(_END.format("floor", "are sunk"), _ADD, lambda o: {"z": o["z"] + o["h"]}),
    Mistake(_END.format("roof", "float"), _SUBTRACT, lambda o: {"z": o["z"] - o["h"]}),
)


LIFTED = tuple(
    Mistake(
        (
            f"the boxes {'float above' if lift > 0 else 'are sunk into'} the ground, by about "
            f"{abs(lift):.1f} m"
        ),
        (
            f"{'subtract' if lift > 0 else 'add'} {abs(lift):.1f} m {'from' if lift > 0 else 'to'} "
            "column 2 (z) of objects"
        ),
        lambda o, lift=lift: {"z": o["z"] - lift},
    )
    for lift in (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, -0.3, -0.4, -0.5, -0.6, -0.8, -1.0)
)


def witnesses(views: Sequence[SensorImages]) -> list[Witness]:
    """Choose moving pixels of each sensor and frame, the same every time."""
    rng = np.random.default_rng(0)
    selected = []
    for i, view in enumerate(views):
        for frame, moving in enumerate(view.moving()):
            pixels = np.flatnonzero(moving)
            if len(pixels) > _POINTS_PER_FRAME:
                pixels = rng.choice(pixels, _POINTS_PER_FRAME, replace=False)
            rays = view.rays[pixels].astype(np.float64)
            depth = view.depth[frame, pixels].astype(np.float64)
            selected.append(Witness(frame, i, rays, depth))
    return selected


def fit(clouds: Sequence[np.ndarray], rows: Sequence[Rows], map_SE3_site: Pose) -> float:
    """Share of points on the boxes of their frame.

    clouds: (n, 3) in the site's frame, one for each frame."""
    on_boxes = 0
    for points, table in zip(clouds, rows, strict=True):
        if not len(points) or not len(table):
            continue
        objects = published.parse_rows(table, map_SE3_site)
        x, y, z = (points.T[:, :, None] - objects.boxes.T[:3, None, :]).astype(np.float32)
        cos = np.cos(objects.boxes[:, 6])
        sin = np.sin(objects.boxes[:, 6])
        offsets = np.abs([x * cos + y * sin, y * cos - x * sin, z])
        half = objects.boxes.T[3:6, None, :] / 2
        inside = np.all(offsets <= half + _SLACK_M, axis=0)
        is_vehicle = np.isin(objects.labels, (VEHICLE, HEAVY))
        core = np.all(offsets <= half * _CORE_SHARE, axis=0) & is_vehicle
        on_boxes += int((np.any(inside, axis=1) & ~np.any(core, axis=1)).sum())
    return on_boxes / max(1, sum(map(len, clouds)))


def collect_clouds(
    witnesses: Sequence[Witness], sensors: Sequence[Sensor], frames: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Points of the witnesses in each frame, site frame."""
    arrays_by_frame: list[list[np.ndarray]] = [[np.zeros((0, 3))] for _ in range(frames)]
    for witness in witnesses:
        arrays_by_frame[witness.frame].append(
            transform(sensors[witness.sensor].pose, witness.rays * witness.depth[:, None])
        )
    return [np.concatenate(arrays) for arrays in arrays_by_frame]


class UndoneObjects(NamedTuple):
    """Mistakes of objects, the rows without them, and their fit."""

    suspicions: list[Suspicion]
    rows: list[Rows]
    fit: float


def suspect_objects(
    witnesses: Sequence[Witness],
    sensors: Sequence[Sensor],
    rows: Sequence[Rows],
    map_SE3_site: Pose,
) -> UndoneObjects:
    """Find the mistake, or pair of mistakes, in the objects.

    Without one, the rows stay as they are."""
    clouds = collect_clouds(witnesses, sensors, len(rows))
    if sum(map(len, clouds)) < MIN_MOVING_POINTS:
        return UndoneObjects([], list(rows), 1.0)
    current = fit(clouds, rows, map_SE3_site)
    for attempts in (
        list(combinations(OBJECT_MISTAKES + LIFTED, 1)),
        list(combinations(OBJECT_MISTAKES, 2)),
    ):
        undone = [_undo_all(mistakes, rows) for mistakes in attempts]
        fits = [fit(clouds, tables, map_SE3_site) for tables in undone]
        best = int(np.argmax(fits))
        if fits[best] >= current + MIN_CLEAR_GAIN and fits[best] >= MIN_EXPLAINED_FIT:
            suspicions = [
                Suspicion(mistake, remedy, current, fits[best])
                for mistake, remedy, _ in attempts[best]
            ]
            return UndoneObjects(suspicions, undone[best], fits[best])
        if current >= MIN_EXPLAINED_FIT:
            break
    return UndoneObjects([], list(rows), current)


def _undo_all(mistakes: Sequence[Mistake], tables: Sequence[Rows]) -> list[Rows]:
    return [_without(mistakes, table) for table in tables]


def _without(mistakes: Sequence[Mistake], rows: Rows) -> Rows:
    for mistake in mistakes:
        table = dict(zip(_COLUMNS, rows.T, strict=True))
        table |= mistake.undo(table)
        rows = np.column_stack([table[name] for name in _COLUMNS])
    return rows


def suspect_sensor(
    witnesses: Sequence[Witness], sensor: Sensor, rows: Sequence[Rows], map_SE3_site: Pose
) -> tuple[Suspicion | None, float]:
    """Find the pose or depth mistake of one sensor by its witnesses. Returns its fit too."""
    stored = published.extrinsic(sensor.pose, map_SE3_site)

    def measure_fit(matrix: np.ndarray, along_ray: bool = False) -> float:
        pose = published.parse_extrinsic(matrix, map_SE3_site)
        rays = [
            w.rays / np.linalg.norm(w.rays, axis=1, keepdims=True) if along_ray else w.rays
            for w in witnesses
        ]
        clouds = [
            transform(pose, ray * w.depth[:, None]) for ray, w in zip(rays, witnesses, strict=True)
        ]
        return fit(clouds, [rows[witness.frame] for witness in witnesses], map_SE3_site)

    current = measure_fit(stored)
    if current > 1 - MIN_CLEAR_GAIN:
        return None, current
    right_handed = published.MAP_FROM_CARLA
    undone = (
        measure_fit(invert(stored)),
        measure_fit(_FORWARD_FIRST @ stored @ right_handed),
        measure_fit(right_handed @ stored @ right_handed),
        measure_fit(stored, along_ray=True),
        measure_fit(np.diag([-1.0, -1, 1, 1]) @ stored),
    )
    pairs = zip(_SENSOR_MISTAKES.items(), undone, strict=True)
    attempts = [Suspicion(mistake, remedy, current, after) for (mistake, remedy), after in pairs]
    best = max(attempts, key=lambda suspicion: suspicion.after)
    return (
        best if best.after >= max(MIN_EXPLAINED_FIT, current + MIN_CLEAR_GAIN) else None
    ), current


def suspect_frames(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    tables: Sequence[Rows],
    frames: Sequence[int],
    map_SE3_site: Pose,
) -> tuple[Suspicion | None, list[Rows]]:
    """Find the number of frames by which objects are off.

    Returns it and the rows that belong to `frames`. clouds: moving points of `frames`, site frame;
    tables: rows of all frames of the file."""
    best: Suspicion | None = None
    rows = [tables[k] for k in frames]
    for offset in [sign * n for n in range(1, MAX_FRAMES_OFF + 1) for sign in (1, -1)]:
        is_usable = [
            0 <= k + offset < len(tables) and len(tables[k]) and len(tables[k + offset])
            for k in frames
        ]
        usable = np.flatnonzero(is_usable).tolist()
        shown_clouds = [clouds[i] for i in usable]
        if sum(map(len, shown_clouds)) < MIN_MOVING_POINTS:
            continue
        before = fit(shown_clouds, [tables[frames[i]] for i in usable], map_SE3_site)
        after = fit(shown_clouds, [tables[frames[i] + offset] for i in usable], map_SE3_site)
        if after >= max(MIN_EXPLAINED_FIT, before + MIN_SHIFT_GAIN) and (
            best is None or after > best.after
        ):
            count = f"{abs(offset)} frame{'s' * (abs(offset) > 1)}"
            mistake = (
                f"labels lie about {count} {'behind' if offset > 0 else 'ahead of'} the images"
            )
            remedy = f"store objects/K as objects/{'K-' if offset > 0 else 'K+'}{abs(offset)}"
            best = Suspicion(mistake, remedy, before, after)
            rows = [
                tables[k + offset] if 0 <= k + offset < len(tables) else tables[k][:0]
                for k in frames
            ]
    return best, rows
