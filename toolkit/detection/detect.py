"""Detection in a recording's frames, saved as boxes.json, OpenLABEL or KITTI's label_2.

Detectors can also be imported by path."""

import inspect
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from time import perf_counter
from typing import Any, Literal

import numpy as np

from toolkit.arrays import Float32
from toolkit.calibration.place import Place, Stand
from toolkit.datasets.box_files import boxes_record, write_boxes
from toolkit.datasets.layouts.kitti import kitti_text
from toolkit.datasets.layouts.openlabel import openlabel_content
from toolkit.detection.standing import StandingScene
from toolkit.frame import Frame
from toolkit.objects import Detections, Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.runtime.stage_times import StageTimes
from toolkit.runtime.writing import write_text, writing_folder
from toolkit.sites.site import Site

Format = Literal["boxes", "openlabel", "kitti"]


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """Detections in one frame, and how they came about.

    Attributes:
        frame: frame with the points in which detection took place.
        detections: detections in the world frame, without background.
        stand: ground and area of the frame.
        detect_ms: milliseconds that detection took, without finding the ground.
        left_out: number of detections that were left out as background.
        read_ms: milliseconds until the frame was there.
        fuse_ms: milliseconds that joining the points took, and moving boxes into the world.
    """

    frame: Frame
    detections: Detections
    stand: Stand
    detect_ms: float
    left_out: int = 0
    read_ms: float = 0.0
    fuse_ms: float = 0.0

    @property
    def stage_ms(self) -> dict[str, float]:
        """Milliseconds of each stage."""
        return {
            "read": self.read_ms,
            "fuse": self.fuse_ms,
            "level": self.stand.ms,
            "detect": self.detect_ms,
        }


def detect_frames(
    frames: Iterable[Frame],
    detector: Detector,
    place: Place = Place(),
    scene: StandingScene | None = None,
) -> Iterator[FrameDetections]:
    """Yield the detections in all points of each frame together, on level ground.

    frames: frames in order, with a `site` if it is known; detector: gets points counted from the
    middle of the area, or at a known site in the site's frame; place: area and ground; scene:
    standing scene, whose detections are left out, None to keep all. A frame without points has no
    detections."""
    end = perf_counter()  # end of the frame before
    for frame, stand in place.stands(frames, getattr(frames, "site", None)):
        read_ms = 1e3 * (perf_counter() - end) - stand.ms
        yield replace(detect_frame(frame, stand, detector, scene), read_ms=read_ms)
        end = perf_counter()


def detect_frame(
    frame: Frame, ground: Stand, detector: Detector, scene: StandingScene | None = None
) -> FrameDetections:
    """Detect in all points of a frame together, on level ground.

    ground: ground and area of the frame; detector: gets points counted from the middle of the
    area, or at a known site in the site's frame; scene: standing scene, whose detections are left
    out, None to keep all."""
    begin = perf_counter()
    site = ground.area if isinstance(ground.area, Site) else None
    # all points of the frame, which a known site needs only to leave out a standing scene
    world_points = frame.points() if site is None or scene is not None else np.zeros((0, 3))
    if site is None:
        points = ground.lift(world_points)
    else:
        points = np.concatenate(frame_points(frame, area=site))
    start = perf_counter()
    lifted_detections = Detections.empty()
    if len(points):
        lifted_detections = detect_on_ground(detector, points, ground.area)
    detect_ms = 1e3 * (perf_counter() - start)
    detections = ground.put_back(lifted_detections)
    kept_detections = detections
    if scene is not None and len(detections):
        kept_detections = scene.leave_out(detections, world_points)
    return FrameDetections(
        frame,
        detections=kept_detections,
        stand=ground,
        detect_ms=detect_ms,
        left_out=len(detections) - len(kept_detections),
        fuse_ms=1e3 * (perf_counter() - begin) - detect_ms,
    )


def write_detections(
    results: Iterable[FrameDetections], out: str | Path, form: Format = "boxes", **more: object
) -> Iterator[FrameDetections]:
    """Write the detections of each frame as they arrive, and yield each frame's result again.

    out: one file of boxes, written at the end, or for other formats a folder with a file per frame,
    complete at the end; form: format of the files; more: further entries in the file of boxes.
    Raises ValueError for two frames whose files would have one name."""
    if form == "boxes":
        records = []  # entries of the file of boxes
        for result in results:
            records.append(boxes_record(result.frame.name, result.frame.time, result.detections))
            yield result
        write_boxes(out, records, **more)
        return
    frame_names: dict[str, str] = {}  # by the names of their files
    with writing_folder(out) as folder:
        for result in results:
            frame = result.frame
            stem = file_name(frame.name)
            if stem in frame_names:
                raise ValueError(
                    f"frames {frame_names[stem]!r} and {frame.name!r} would both be written to "
                    f"{stem!r}: write --format boxes, one file for all"
                )
            frame_names[stem] = frame.name
            if form == "openlabel":
                text = json.dumps(openlabel_content(frame, result.detections), indent=1)
                write_text(folder / f"{stem}.json", text)
            else:
                text = kitti_text(frame, found=result.detections)
                write_text(folder / f"{stem}.txt", text)
            yield result


def file_name(name: str) -> str:
    """Replace letters of a frame's name that are not safe in a file name by "_"."""
    return "".join(letter if letter.isalnum() or letter in "-_.#" else "_" for letter in name)


def summarise(results: Iterable[FrameDetections], *, timings: bool = False) -> dict[str, Any]:
    """Count frames, detections and problems, with median times.

    timings: True to add median, p95 and p99 of each stage. Returns `samples`, `detections`,
    `problems` by kind, and the median milliseconds to find the ground (`level_ms`) and to detect
    (`detect_ms`), None without frames; with timings `timings`, see `StageTimes.summarise`."""
    times = StageTimes()
    samples = 0
    detections = 0
    problems = Counter[str]()
    level_ms = list[float]()
    detect_ms = list[float]()
    for result in results:
        samples += 1
        detections += len(result.detections)
        problems.update(result.frame.problems)
        level_ms.append(result.stand.ms)
        detect_ms.append(result.detect_ms)
        times.add_all(result.stage_ms)
    figures: dict[str, Any] = {
        "samples": samples,
        "detections": detections,
        "problems": dict(problems),
        "level_ms": float(np.median(level_ms)) if samples else None,
        "detect_ms": float(np.median(detect_ms)) if samples else None,
    }
    return figures | {"timings": times.summarise()} if timings else figures


def describe_summary(figures: dict[str, Any]) -> str:
    """Return a summary as a line of text; figures: as returned by `summarise`.

    Counts come first, such as "12 detections in 3 clouds; 4 ms to level, 20 ms to detect", then the
    problems by kind."""
    actions = {"level_ms": "to level", "detect_ms": "to detect"}
    times = [
        f"{figures[name]:.0f} ms {action}"
        for name, action in actions.items()
        if figures[name] is not None
    ]
    problems = [f"{number} {kind}" for kind, number in figures["problems"].items()]
    counts = f"{figures['detections']} detections in {figures['samples']} clouds"
    return "; ".join(text for text in (counts, ", ".join(times), ", ".join(problems)) if text)


def resolve_detector(name: str) -> Any:
    """Import the callable named `package.module:callable`, also from the current folder.

    The folder is added to `sys.path`. Raises ValueError in one line if the name has another form,
    cannot be imported, or names something that cannot be called."""
    if not re.fullmatch("[^:]+:[^:]+", name):
        raise ValueError(
            f"a detector to import must be named package.module:callable, got {name!r}"
        )
    module, attribute = name.split(":", 1)
    if module.endswith(".py") or "/" in module or "\\" in module:
        folder = Path(module).parent
        stem = Path(module).name.removesuffix(".py")
        remedy = (
            f"write {stem}:{attribute}"
            if folder == Path()
            else f"run it in {folder}, as {stem}:{attribute}"
        )
        raise ValueError(
            f"detector {name} must be named as Python imports it, not by its file: {remedy}"
        )
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # modules of the current folder are found last
    try:
        target = resolve_name(name)
    except Exception as error:  # importing runs the module, which may raise anything
        raise ValueError(
            f"detector {name} cannot be imported ({type(error).__name__}: {error})"
        ) from error
    if not callable(target):
        raise ValueError(f"detector {name} must be callable, got {type(target).__name__}")
    return target


class ImportedDetector:
    """Any Python detector by its import path `package.module:callable`, also from the current
    folder.

    The name is a detector, called with the points (n, 3) of a frame, world frame, m, or a factory:
    a class, or a callable with a parameter `site` (a `Site`) or `area` (xmin ymin xmax ymax, m), or
    no parameter. Its detections are cached for later runs only if it has an attribute `digest`, a
    text that changes with everything they depend on. A pickled detector holds only name and site,
    so that another process imports it again. Raises
    ValueError, in one line, if the import fails or the detector returns anything but `Detections`
    for a cloud without points."""

    def __init__(self, name: str, site: Site) -> None:
        """Import a detector, make it for the site if it is a factory, and try it once.

        name: its import path. Raises ValueError if it cannot be made."""
        self.name = name
        self.site = site
        target = resolve_detector(name)
        possible_arguments = {"site": site, "area": tuple(site.area.tolist())}
        # A factory makes the detector: it is a class, takes the site or its area, or takes no
        # argument. Anything else is the detector itself.
        try:
            parameters = inspect.signature(target).parameters
            arguments = {
                key: value for key, value in possible_arguments.items() if key in parameters
            }
            is_factory = bool(arguments) or not parameters or inspect.isclass(target)
            self._detect = target(**arguments) if is_factory else target
        except Exception as error:  # making the detector may raise anything
            raise ValueError(
                f"detector {name} cannot be made ({type(error).__name__}: {error})"
            ) from error
        # try it with a cloud without points, so that errors show before any work
        self(np.zeros((0, 3), np.float32))

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Detect in one cloud, world frame (m).

        Raises ValueError if the detector fails or returns anything but `Detections`."""
        try:
            detections = self._detect(points)
        except Exception as error:  # the detector may raise anything
            failure = (
                f"fails with a cloud of {len(points) or 'no'} points ({type(error).__name__}: "
                f"{error})"
            )
            remedy = "let it take any points (n, 3) and return Detections"
            raise ValueError(f"detector {self.name} {failure}: {remedy}") from error
        if not isinstance(detections, Detections):
            kind = type(detections).__name__
            raise ValueError(
                f"detector {self.name} must return toolkit.objects.Detections, got {kind}"
            )
        return detections

    @property
    def digest(self) -> str:
        """Digest of the imported detector; AttributeError if it has no digest."""
        return str(self._detect.digest)

    @property
    def labels(self) -> Sequence[str]:
        """Names of the classes that the imported detector knows; AttributeError if not given."""
        labels: Sequence[str] = self._detect.labels
        return labels

    def __reduce__(self) -> "tuple[type[ImportedDetector], tuple[str, Site]]":
        return ImportedDetector, (self.name, self.site)
