"""Looks a dataset over for the classic mistakes and says which it suspects, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset, UnknownSite, check_kinds, object_rows, open_file
from toolkit.datasets.doctor.checks import UNKNOWN, Finding, check_measurements
from toolkit.runtime import hdf5
from toolkit.sites.site import Site


def diagnose(path: str | Path, site: Site | None = None) -> list[Finding]:
    """What looks wrong in a dataset, ours or a published one; an empty list for a healthy one.

    All tables of objects are looked at, and the measurements of some frames. Raises FileNotFoundError where there is no
    such file; all other damage is a finding.
    """
    try:
        with open_file(path) as file:
            check_kinds(file)
            units, (tables, whole, damaged) = _depth_units(file), _tables(file)
        with CoopDataset(path, site or _place(path)) as dataset:
            if not len(dataset):
                return [Finding("error", "dslices", "no frames", "it has 0 frames", "record some, or restore the file")]
            return damaged + _repetitions(tables, whole) + check_measurements(dataset, tables, units)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        return [Finding("error", str(path), "it cannot be read", str(error), "repair it or restore it")]


def _depth_units(file: h5py.File) -> tuple[float, ...]:
    """What the file's depth may have to be multiplied by to be metres, judged by its largest number."""
    if not hdf5.holds(file, "dslices"):
        return (1.0,)
    images = hdf5.dataset(file, "dslices", kinds="fiub")
    if images.ndim != 4 or not len(images):
        return (1.0,)
    image = hdf5.rows(images, "dslices", len(images) // 2).astype(np.float64)
    largest = float(np.max(image, where=np.isfinite(image), initial=0.0))
    if 0 < largest <= 1.0:
        return (published.NO_RETURN,)  # CARLA's own encoding, parts of the far plane
    if largest <= 1.01 * published.NO_RETURN:
        return (1.0,)
    return tuple(unit for unit in (1.0, 0.01, 0.001) if largest * unit <= 2 * published.NO_RETURN) or (0.001,)


def _tables(file: h5py.File) -> tuple[list[np.ndarray], list[bool], list[Finding]]:
    """The published rows of all frames without the damaged ones, which are whole, and what is wrong in the first three
    that are not."""
    images = [name for name in ("dslices", "coview/time") if hdf5.holds(file, name)]
    shape = hdf5.dataset(file, images[0], kinds="fiub").shape if images else ()
    frames = shape[0] if shape else 0
    tables: list[np.ndarray] = []
    whole: list[bool] = []
    findings: list[Finding] = []
    for k in range(frames):
        table, wrong = _table(file, k)
        tables.append(table)
        whole.append(not wrong)
        if wrong and len(findings) < 3:
            findings.append(Finding("error", f"objects/{k}", "damaged objects", wrong, "repair or leave out the frame"))
    return tables, whole, findings


def _table(file: h5py.File, k: int) -> tuple[np.ndarray, str]:
    nothing = np.zeros((0, len(published.OBJECT_COLUMNS)))
    try:
        rows = object_rows(file, f"objects/{k}")
    except (ValueError, OSError) as error:
        return nothing, str(error)
    words = published.wrong_rows(rows)
    sound = rows[words == ""] if rows.ndim == 2 and len(words) == len(rows) else rows
    try:
        published.objects_of(sound, np.eye(4))
    except ValueError as error:
        return nothing, str(error).removeprefix("objects ")
    wrong = f"row {int((words != '').argmax())} {words[words != ''][0]}" if (words != "").any() else ""
    return np.asarray(sound, np.float64), wrong


def _repetitions(tables: Sequence[np.ndarray], whole: Sequence[bool]) -> list[Finding]:
    """Frames without objects, and frames that come twice."""
    findings = []
    empty = [k for k, table in enumerate(tables) if whole[k] and not len(table)]
    if empty:
        evidence = f"{len(empty)} of {len(tables)} frames, the first is {empty[0]}"
        remedy = "right if nothing was there, else restore their objects"
        findings.append(Finding("warning", f"objects/{empty[0]}", "frames without objects", evidence, remedy))
    first: dict[bytes, int] = {}
    twins = [(first.setdefault(table.tobytes(), k), k) for k, table in enumerate(tables) if len(table)]
    twins = [(original, copy) for original, copy in twins if original != copy]
    if twins:
        evidence = f"{len(twins)} of {len(tables)} frames, frame {twins[0][1]} has the objects of frame {twins[0][0]}"
        remedy = "leave the copies out, or they count twice in training and AP"
        findings.append(Finding("warning", f"objects/{twins[0][1]}", "duplicated frames", evidence, remedy))
    return findings


def _place(path: str | Path) -> Site | None:
    """None where the file or its coordinates say which site it shows; else just any, so that a file from
    anywhere can be looked at."""
    try:
        CoopDataset(path).close()
    except UnknownSite:
        return Site(UNKNOWN, np.array([-1.0, -1, 1, 1]))
    return None
