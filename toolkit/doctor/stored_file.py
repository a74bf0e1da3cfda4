"""Doctor of a file of images: its tables of objects, its times and its measurements."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.image_file import check_kinds, object_rows, open_file
from toolkit.datasets.stored_site import UnknownSite
from toolkit.doctor.findings import Finding, report_error
from toolkit.doctor.frame_times import suspect_times
from toolkit.doctor.measurements import check_measurements
from toolkit.doctor.site_area import UNKNOWN_SITE
from toolkit.runtime import hdf5
from toolkit.sites.site import Site


def diagnose_file(path: str | Path, site: Site | None = None) -> list[Finding]:
    """Diagnose a file of images, ours or a published one; no findings for a healthy one.

    All tables of objects are checked, and the measurements of some frames. site: site of the file,
    None if it names its site or shows a built-in one. Raises FileNotFoundError for a missing file;
    all other damage is a finding."""
    try:
        with open_file(path) as file:
            check_kinds(file)
            units = _list_depth_units(file)
            stored_tables = _read_tables(file)
        try:
            dataset = CoopDataset(path, site)
        except UnknownSite:  # any site serves to check the file
            dataset = CoopDataset(path, Site(UNKNOWN_SITE, np.array([-1.0, -1, 1, 1])))
        with dataset:
            if not len(dataset):
                remedy = "record some, or restore the file"
                return [
                    report_error(
                        where="dslices",
                        suspected="no frames",
                        evidence="it has 0 frames",
                        remedy=remedy,
                    )
                ]
            findings = stored_tables.findings
            if dataset.times is not None:
                findings += suspect_times(dataset.times)
            findings += _suspect_repetitions(stored_tables.tables, stored_tables.is_readable)
            return findings + check_measurements(dataset, stored_tables.tables, units)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        return [
            report_error(
                where=str(path),
                suspected="it cannot be read",
                evidence=str(error),
                remedy="repair it or restore it",
            )
        ]


def _list_depth_units(file: h5py.File) -> tuple[float, ...]:
    """Factors that may turn the file's depth into metres, chosen by its largest number.

    The number is from the image in the middle of `dslices`, the file's depth images. Returns the
    factor 1 for a file without it."""
    if not hdf5.contains(file, "dslices"):
        return (1.0,)
    images = hdf5.dataset(file, "dslices", kinds="fiub")
    if images.ndim != 4 or not len(images):
        return (1.0,)
    image = hdf5.rows(images, "dslices", len(images) // 2).astype(np.float64)
    max_value = float(np.max(image, where=np.isfinite(image), initial=0.0))
    if 0 < max_value <= 1.0:
        return (published.NO_RETURN_M,)  # CARLA's encoding, parts of the far plane
    if max_value <= 1.01 * published.NO_RETURN_M:
        return (1.0,)
    # metres, centimetres or millimetres, if the largest depth is then plausible
    plausible_units = tuple(
        unit for unit in (1.0, 0.01, 0.001) if max_value * unit <= 2 * published.NO_RETURN_M
    )
    return plausible_units or (0.001,)


class _StoredTables(NamedTuple):
    """Tables of objects of a file.

    Attributes:
        tables: published rows of each frame, without invalid ones; none for an unreadable frame.
        is_readable: for each frame, True if its table has no fault.
        findings: the first faults."""

    tables: list[np.ndarray]
    is_readable: list[bool]
    findings: list[Finding]


def _read_tables(file: h5py.File) -> _StoredTables:
    """Read the objects of all frames; only the first three damaged frames become findings."""
    # any dataset with a row for each frame gives the number of frames
    names = [*hdf5.find_kinds(file, ("dslices", "coview/time"))]
    shape = hdf5.dataset(file, names[0], kinds="fiub").shape if names else ()
    frame_count = shape[0] if shape else 0
    tables: list[np.ndarray] = []
    faults: list[str] = []  # each frame's fault, "" for a sound one
    for k in range(frame_count):
        table = np.zeros((0, len(published.OBJECT_COLUMNS)))
        fault = ""
        try:
            rows = object_rows(file, f"objects/{k}")
            row_faults = published.wrong_rows(rows)  # words for each row, "" for a sound one
            is_sound = row_faults == ""
            published.parse_rows(rows[is_sound], np.eye(4))  # raises ValueError for wrong values
            table = np.asarray(rows[is_sound], np.float64)
            if not is_sound.all():
                first_wrong = int((~is_sound).argmax())
                fault = f"row {first_wrong} {row_faults[first_wrong]}"
        except (ValueError, OSError) as error:
            fault = str(error).removeprefix("objects ")
        tables.append(table)
        faults.append(fault)
    # place and fault of the first damaged tables
    damaged_tables = [(f"objects/{k}", fault) for k, fault in enumerate(faults) if fault][:3]
    remedy = "repair or leave out the frame"
    findings = [
        report_error(where=where, suspected="damaged objects", evidence=fault, remedy=remedy)
        for where, fault in damaged_tables
    ]
    is_readable = [not fault for fault in faults]
    return _StoredTables(tables=tables, is_readable=is_readable, findings=findings)


def _suspect_repetitions(
    tables: Sequence[np.ndarray], is_readable: Sequence[bool]
) -> list[Finding]:
    """Find frames without objects, and frames that occur twice.

    tables: published rows of each frame; is_readable: for each frame, True if its table has no
    fault, so that an empty one has no objects."""
    findings = []
    empty_frames = [k for k, table in enumerate(tables) if is_readable[k] and not len(table)]
    if empty_frames:
        first_empty = empty_frames[0]
        evidence = f"{len(empty_frames)} of {len(tables)} frames, the first is {first_empty}"
        remedy = "right if nothing was there, else restore their objects"
        findings.append(
            Finding(
                severity="warning",
                where=f"objects/{first_empty}",
                suspected="frames without objects",
                evidence=evidence,
                remedy=remedy,
            )
        )
    frame_by_bytes: dict[bytes, int] = {}  # first frame with these rows, by the rows' bytes
    copies: list[tuple[int, int]] = []  # frame of the original, frame of the copy
    for k, table in enumerate(tables):
        if len(table):
            original_frame = frame_by_bytes.setdefault(table.tobytes(), k)
            if original_frame != k:
                copies.append((original_frame, k))
    if copies:
        original_frame, copy = copies[0]
        evidence = (
            f"{len(copies)} of {len(tables)} frames, frame {copy} has the objects of frame "
            f"{original_frame}"
        )
        remedy = "leave the copies out, or they count twice in training and AP"
        findings.append(
            Finding(
                severity="warning",
                where=f"objects/{copy}",
                suspected="duplicated frames",
                evidence=evidence,
                remedy=remedy,
            )
        )
    return findings
