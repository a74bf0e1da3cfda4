"""Looks a dataset over for the classic mistakes and says which it suspects, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset, check_kinds, open_file
from toolkit.datasets.doctor.checks import UNKNOWN, Finding, check_measurements
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
    except (OSError, ValueError, KeyError) as error:
        return [Finding("error", str(path), "it cannot be read", str(error), "repair it or restore it")]


def _depth_units(file: h5py.File) -> tuple[float, ...]:
    """What the file's depth may have to be multiplied by to be metres, judged by its largest number."""
    if "dslices" not in file or file["dslices"].ndim != 4 or not len(file["dslices"]):
        return (1.0,)
    image = np.asarray(file["dslices"][len(file["dslices"]) // 2], np.float64)
    largest = float(np.max(image, where=np.isfinite(image), initial=0.0))
    if 0 < largest <= 1.0:
        return (published.NO_RETURN,)  # CARLA's own encoding, parts of the far plane
    if largest <= 1.01 * published.NO_RETURN:
        return (1.0,)
    return tuple(unit for unit in (1.0, 0.01, 0.001) if largest * unit <= 2 * published.NO_RETURN) or (0.001,)


def _tables(file: h5py.File) -> tuple[list[np.ndarray], list[bool], list[Finding]]:
    """The published rows of all frames without the damaged ones, which are whole, and what is wrong in the first three
    that are not."""
    frames = len(file["dslices"]) if "dslices" in file else len(file.get("coview/time", ()))
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
    if f"objects/{k}" not in file:
        return nothing, "it is missing"
    rows = file[f"objects/{k}"]
    rows = rows[()] if rows.size else nothing
    try:
        published.objects_of(rows, np.eye(4))
    except ValueError as error:
        return nothing, str(error).removeprefix("objects ")
    rows = np.asarray(rows, np.float64)
    flat = (rows[:, 6:9] <= 0).any(axis=1)
    if flat.any():
        return rows[~flat], f"row {np.argmax(flat)} has half extents {rows[flat][0, 6:9].tolist()}"
    return rows, ""


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
    except ValueError as error:
        if "pass site=" not in str(error):
            raise
    else:
        return None
    return Site(UNKNOWN, np.array([-1.0, -1, 1, 1]))
