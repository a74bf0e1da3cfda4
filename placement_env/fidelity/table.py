"""`Table`: the AP of every set of a site's sensors, measured once for each scheme and IoU threshold
with a detector.

The row number is a bit mask: sensor c belongs to the sets whose number has bit c. The tables of the
built-in sites, with the shipped detectors, are in `exact/`; `make_table` makes them again."""

import json
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.detector import IOUS, Detected, Measured
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import Sets, all_subsets
from toolkit.arrays import Bool, Float64, Int64
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES, find_scheme
from toolkit.objects import LABELS, VEHICLE, Detector
from toolkit.runtime.array_files import read_arrays, write_arrays
from toolkit.runtime.cache import Cache, make_key
from toolkit.runtime.run import Processes
from toolkit.runtime.text_values import parse_json
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.sensor import Sensor
from toolkit.sites import BUILT_IN
from toolkit.sites.files import format_site, load_site
from toolkit.sites.site import HYBRID_RADIUS_M, Site

SHIPPED = Path(__file__).parent / "exact"
MAX_SENSOR_KBIT = 1e6  # data of one sensor in a frame: ten million points
_no_more = partial(np.zeros, (0, 0, 0, 0))  # figures of further classes if there is only one


class TableColumn(NamedTuple):
    """Figures of all sets of a table, row by row, for one scheme, class and IoU threshold.

    Attributes:
        ap: AP of each set.
        recall: Recall of each set.
        kbit: Data of all sensors of each set per frame, the same for all classes."""

    ap: Float64[np.ndarray, " sets"]
    recall: Float64[np.ndarray, " sets"]
    kbit: Float64[np.ndarray, " sets"]


@dataclass(frozen=True)
class TableOrigin:
    """Sensors, frames and detector that a table of all sensor sets was measured with.

    Raises ValueError unless there are IoU thresholds for each class.

    Attributes:
        site: Name of the site.
        sensors: Names of the sensors; their order gives the bits of a row's number.
        place: Digest of site and sensors (`hash_site`).
        frames: Number of frames.
        objects: Number of objects to be found in all frames.
        recording: Digest of the recording.
        detector: Digest of the detector.
        seed: Seed of the noise.
        commit: Commit of this project.
        hybrid_radius: Radius of hybrid fusion (m).
        errors: Name of the sensors' error profile.
        classes: Classes that the table has figures for.
        ious: For each class, its IoU threshold for each of `IOUS`."""

    site: str
    sensors: tuple[str, ...]
    place: str
    frames: int
    objects: int
    recording: str
    detector: str
    seed: int
    commit: str
    hybrid_radius: float = HYBRID_RADIUS_M
    errors: str = PAPER_ERRORS.name
    classes: tuple[str, ...] = VEHICLES.names
    ious: tuple[tuple[float, ...], ...] = (IOUS,)

    def __post_init__(self) -> None:
        """Raise ValueError unless each class has all thresholds."""
        has_all_thresholds = all(len(thresholds) == len(IOUS) for thresholds in self.ious)
        if len(self.ious) != len(self.classes) or not has_all_thresholds:
            raise ValueError(
                f"there must be {len(IOUS)} IoU thresholds of each of {self.classes}, got "
                f"{self.ious}"
            )


@dataclass(frozen=True, eq=False)
class Table:
    """AP, recall and data of all sets of some sensors, measured with a detector.

    Row number r is the set of the sensors c for which r has bit c. Schemes are as in
    `PAPER_SCHEMES`, IoU thresholds as in `TableOrigin.ious`. Figures of a class
    without an object are all NaN.

    Attributes:
        origin: Sensors, frames and detector.
        ap: AP for the first class.
        recall: Recall for the first class.
        kbit: Data of all sensors of a set per frame, by the paper's codec.
        more_ap: AP for the other classes.
        more_recall: Recall for the other classes.

    Raises ValueError if the shapes do not fit, and for figures that are impossible."""

    origin: TableOrigin
    ap: Float64[np.ndarray, "sets schemes ious"] = field(repr=False)
    recall: Float64[np.ndarray, "sets schemes ious"] = field(repr=False)
    kbit: Float64[np.ndarray, "sets schemes"] = field(repr=False)
    more_ap: Float64[np.ndarray, "others _ _ _"] = field(default_factory=_no_more, repr=False)
    more_recall: Float64[np.ndarray, "others _ _ _"] = field(default_factory=_no_more, repr=False)

    def __post_init__(self) -> None:
        """Raise ValueError for arrays of a wrong shape and figures out of range."""
        sets = 1 << len(self.origin.sensors)  # 2^C
        shape = (sets, len(PAPER_SCHEMES), len(IOUS))  # axes of AP and recall; kbit lack the last
        if not self.ap.shape == self.recall.shape == shape or self.kbit.shape != shape[:2]:
            raise ValueError(
                f"a table of {len(self.origin.sensors)} sensors must be {shape}, got "
                f"{self.ap.shape}"
            )
        more_classes = len(self.origin.classes) - 1
        if more_classes and not self.more_ap.shape == self.more_recall.shape == (
            more_classes,
            *shape,
        ):
            raise ValueError(
                f"a table of {self.origin.classes} needs {(more_classes, *shape)}, got "
                f"{self.more_ap.shape}"
            )
        for figures in (self.ap, self.recall, *self.more_ap, *self.more_recall):
            wrong_figures = figures[~((figures >= 0) & (figures <= 1))]  # NaN too
            if len(wrong_figures) and not np.isnan(figures).all():
                raise ValueError(f"AP and recall must lie in 0..1, got {wrong_figures[0]:g}")
        max_kbit = MAX_SENSOR_KBIT * len(self.origin.sensors)
        if not ((self.kbit >= 0) & (self.kbit <= max_kbit)).all():
            raise ValueError(
                f"kbit must lie in 0..{max_kbit:g}, got {self.kbit.min():g} to {self.kbit.max():g}"
            )

    def column(self, scheme: Scheme | str, name: str, iou: float) -> TableColumn:
        """AP, recall and kbit of all sets, row by row, for one scheme, class and IoU threshold.

        Args:
            scheme: Fusion scheme, or its name.
            name: Name of the class.
            iou: IoU threshold of this class.

        Raises ValueError for a scheme, class or threshold that was not measured."""
        if name not in self.origin.classes:
            problem = f"this table holds {', '.join(self.origin.classes)}, not {name}"
            raise ValueError(
                f"{problem}: make one with coview table --classes, or say --fidelity detector"
            )
        class_index = self.origin.classes.index(name)
        scheme = find_scheme(scheme)
        if class_index:
            ap = self.more_ap[class_index - 1]
            recall = self.more_recall[class_index - 1]
        else:
            ap = self.ap
            recall = self.recall
        thresholds = self.origin.ious[class_index]
        if (
            iou not in thresholds
            or scheme.name not in PAPER_SCHEMES
            or scheme != SCHEMES[scheme.name]
        ):
            class_words = "" if name == LABELS[VEHICLE] else f" of {name}"
            problem = (
                f"tables have schemes {', '.join(PAPER_SCHEMES)} and IoU "
                f"{tuple(dict.fromkeys(thresholds))}{class_words}"
            )
            raise ValueError(f"{problem}, got {scheme.name!r} and {iou}: say --fidelity detector")
        s = PAPER_SCHEMES.index(scheme.name)
        i = thresholds.index(iou)
        return TableColumn(ap=ap[:, s, i], recall=recall[:, s, i], kbit=self.kbit[:, s])

    @property
    def subsets(self) -> Bool[np.ndarray, "sets sensors"]:
        """Set of each row of the table, as rows of booleans; the empty one is first."""
        return all_subsets(len(self.origin.sensors))

    def row(self, subsets: Sets) -> Int64[np.ndarray, " n"]:
        """Number of the table's row for each set, given as rows of booleans.

        It is the sum of 2^c over the sensors c of the set."""
        if subsets.shape[1] != len(self.origin.sensors):
            raise ValueError(
                f"sets must be rows of {len(self.origin.sensors)} sensors, got {subsets.shape}"
            )
        return subsets @ (1 << np.arange(subsets.shape[1]))


class TableFidelity:
    """Score sets of a site's sensors by looking them up in a table measured with a detector.

    Args:
        table: Table of all sets of the sensors.
        scheme: Fusion scheme, or its name.
        iou: IoU threshold of vehicles; `Classes.get_iou` gives the ones for other classes.
        codec: Codec of the data sent, which must be the paper's.
        classes: Classes that count; several are combined.

    Raises ValueError for a scheme, IoU threshold, class or codec that the table lacks."""

    name = "table"

    def __init__(
        self,
        table: Table,
        scheme: Scheme | str = "early",
        iou: float = 0.7,
        codec: Codec = PAPER,
        *,
        classes: Classes = VEHICLES,
    ) -> None:
        """Take the figures of a scheme and IoU threshold from a table.

        Raises ValueError for another codec than the paper's."""
        self.table = table
        self.classes = classes
        columns = [table.column(scheme, name, classes.get_iou(name, iou)) for name in classes.names]
        # figures of all sets of the table: AP and recall for each class; kbit, the same for all
        self._ap = [column.ap for column in columns]
        self._recall = [column.recall for column in columns]
        self._kbit = columns[0].kbit
        if codec != PAPER:
            raise ValueError(
                f"tables hold kbit of the paper's codec, got {codec}: say --fidelity detector"
            )

    def __call__(self, subsets: Sets, /) -> Estimate:
        """AP, recall and kbit of each set; several classes are combined."""
        if len(self.classes.names) > 1:
            return self.by_class(subsets).combined(self.classes)
        rows = self.table.row(subsets)
        return Estimate(ap=self._ap[0][rows], recall=self._recall[0][rows], kbit=self._kbit[rows])

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """AP and recall of each set for each class, and kbit of the set."""
        rows = self.table.row(subsets)
        ap = np.stack([column[rows] for column in self._ap], axis=1)
        recall = np.stack([column[rows] for column in self._recall], axis=1)
        return ClassEstimates(ap=ap, recall=recall, kbit=self._kbit[rows])


class Best(NamedTuple):
    """One of the best sets.

    Attributes:
        sensors: Indices of its sensors, ascending.
        ap: Its AP (0 to 1)."""

    sensors: tuple[int, ...]
    ap: float


def best_sets(
    table: Table,
    scheme: Scheme | str = "early",
    iou: float = 0.7,
    top: int = 3,
    *,
    classes: Classes = VEHICLES,
) -> dict[int, list[Best]]:
    """Best sets by number of sensors, as the paper's table lists them: all sensors come first.

    Args:
        table: Table of all sets.
        scheme: Fusion scheme, or its name.
        iou: IoU threshold of vehicles.
        top: Number of sets to give for each number of sensors, best first.
        classes: Classes that count."""
    subsets = table.subsets
    ap = TableFidelity(table, scheme, iou, classes=classes)(subsets).ap
    sizes = subsets.sum(axis=1)
    by_size = {}
    for size in range(len(table.origin.sensors), 0, -1):
        rows = np.flatnonzero(sizes == size)
        best_rows = rows[np.argsort(-ap[rows], kind="stable")][:top]
        by_size[size] = [
            Best(sensors=tuple(np.flatnonzero(subsets[row]).tolist()), ap=float(ap[row]))
            for row in best_rows
        ]
    return by_size


def make_table(
    renders: Measured,
    detector: Detector,
    out: str | Path,
    *,
    frames: int | None = None,
    seed: int = 0,
    commit: str = "",
    classes: Classes = VEHICLES,
    processes: Processes = Processes(),
) -> Table:
    """Score every sensor set by detection, in each scheme and for each class, and write the table.

    Detections are kept in a file next to `out` until the table is complete, so a killed run
    resumes with the same table.

    Args:
        renders: Measurements of the sensors.
        detector: Detector that scores the sets.
        out: Path of the .npz file.
        frames: Number of frames from the first on, None for all.
        seed: Seed of the noise in `renders`, only written down.
        commit: Commit of this project, only written down.
        classes: Classes of the objects.
        processes: Processes that work on the frames."""
    out = Path(out)
    subsets = all_subsets(len(renders.sensors))
    count = len(range(renders.frames)[:frames])
    memo = Cache(out.with_name(out.name + ".detections"))
    columns: list[list[ClassEstimates]] = []
    for scheme_number, scheme in enumerate(PAPER_SCHEMES):
        detected = Detected(
            renders, detector, scheme, memo=memo, processes=processes, classes=classes
        )
        report = processes.stage(
            "frames scored", len(PAPER_SCHEMES) * count, before=scheme_number * count
        )
        columns.append(list(detected.class_estimates(subsets, frames, report).values()))
    origin = TableOrigin(
        site=renders.site.name,
        sensors=tuple(sensor.name for sensor in renders.sensors),
        place=hash_site(renders.site, renders.sensors),
        frames=count,
        objects=sum(int(detected.scored(k).sum()) for k in range(count)),
        recording=renders.digest,
        detector=getattr(detector, "digest", ""),
        seed=seed,
        commit=commit,
        hybrid_radius=renders.site.hybrid_radius,
        errors=getattr(renders, "errors", PAPER_ERRORS).name,
        classes=classes.names,
        ious=tuple(_list_thresholds(classes, name) for name in classes.names),
    )
    ap = _stack_classes(columns, "ap")
    recall = _stack_classes(columns, "recall")
    kbit = np.stack([column[0].kbit for column in columns], axis=1)
    table = Table(
        origin, ap=ap[0], recall=recall[0], kbit=kbit, more_ap=ap[1:], more_recall=recall[1:]
    )
    save_table(table, out)
    memo.delete()
    return table


def _list_thresholds(classes: Classes, name: str) -> tuple[float, ...]:
    """IoU threshold of a class (name) for each of `IOUS`, the thresholds of vehicles."""
    return tuple(classes.get_iou(name, iou) for iou in IOUS)


def _stack_classes(
    columns: list[list[ClassEstimates]], figure: str
) -> Float64[np.ndarray, "classes sets schemes ious"]:
    """Stack one figure of the estimates for each scheme (outer list) and IoU threshold (inner).

    figure: Name of the field, "ap" or "recall"."""
    by_scheme = []
    for column in columns:
        by_scheme.append([getattr(estimates, figure) for estimates in column])
    # from (schemes, ious, sets, classes)
    return np.transpose(by_scheme, (3, 2, 0, 1)).copy()


def hash_site(site: Site, sensors: Sequence[Sensor]) -> str:
    """SHA-256 (hexadecimal) over a site and its sensors; a table applies to no others.

    The hybrid radius is left out: `TableOrigin` has it in a separate field."""
    descriptions = []
    for sensor in sensors:
        pose = sensor.pose.round(4) + 0.0  # + 0.0 makes -0.0 to 0.0
        descriptions.append((type(sensor.model).__name__, astuple(sensor.model), pose.tolist()))
    return make_key(format_site(site, without=["hybrid_radius"]), descriptions).hex()


def save_table(table: Table, path: str | Path) -> None:
    """Write a table to a .npz file, which is replaced whole or not at all."""
    arrays = {"ap": table.ap, "recall": table.recall, "kbit": table.kbit}
    if len(table.origin.classes) > 1:
        arrays |= {"more_ap": table.more_ap, "more_recall": table.more_recall}
    # the origin as the bytes of a JSON text
    arrays["origin"] = np.frombuffer(json.dumps(vars(table.origin)).encode(), np.uint8)
    write_arrays(path, arrays)


def load_table(name: str | Path) -> Table:
    """Load the shipped table of a built-in site, or the table in a file.

    name: Name of the site, or a path that ends in .npz. Raises FileNotFoundError; ValueError for a
    damaged file."""
    path = Path(name) if Path(name).suffix == ".npz" else SHIPPED / f"{name}.npz"
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.npz"))) or "none yet"
        raise FileNotFoundError(
            f"no table {str(name)!r}; shipped: {shipped}; make one with coview table"
        )
    arrays = read_arrays(path)
    if wrong_columns := [
        key for key, column in arrays.items() if key != "origin" and column.dtype.kind != "f"
    ]:
        problem = f"{wrong_columns[0]} must hold real numbers, got {arrays[wrong_columns[0]].dtype}"
        raise ValueError(
            f"{path} is no table of sensor sets ({problem}): make it again with coview table"
        )
    try:
        values: dict[str, Any] = parse_json(arrays.pop("origin").tobytes().decode())
        # a table without a radius was made when only the built-in sites had one of their own
        site = values["site"]
        default_radius = load_site(site).hybrid_radius if site in BUILT_IN else HYBRID_RADIUS_M
        values = {
            "hybrid_radius": default_radius,
            "classes": VEHICLES.names,
            "ious": [IOUS],
            **values,
        }
        # JSON has lists instead of tuples
        values |= {name: tuple(values[name]) for name in ("sensors", "classes")}
        values["ious"] = tuple(tuple(map(float, thresholds)) for thresholds in values["ious"])
        return Table(TableOrigin(**values), **arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is no table of sensor sets ({error}): make it again with coview table"
        ) from None
