"""The classic mistakes of labels, made in the files of each layout, in the file's own numbers,
units and frame.

`TERMS` says of each layout how its boxes are read out of its files and written back: x y z, length,
width, height and yaw as they stand there, whatever they mean. `MISTAKES` changes these numbers as
somebody would who took the layout's convention for the usual other one.
"""

import json
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np

X, Y, Z, LENGTH, WIDTH, HEIGHT, YAW = range(7)
LATE = 2  # samples that labels lie behind their clouds


@dataclass(frozen=True, eq=False)
class Row:
    """One box: the seven numbers of the file, and the record they stand in."""

    numbers: np.ndarray
    record: Any


Tables = list[list[Row]]  # of one agent: the boxes of each sample


@dataclass(frozen=True)
class Terms:
    """read: the boxes of each agent's samples; write: them, changed, in place of those that are
    there; degrees: whether yaw is in degrees; halves: whether sizes are; camera: whether the frame
    is that of a camera, x right, y down, z ahead, with the centre of the floor."""

    read: Callable[[Path], list[Tables]]
    write: Callable[[Path, list[Tables]], None]
    degrees: bool = False
    halves: bool = False
    camera: bool = False


Mistake = Literal[
    "mirrored", "degrees", "extents", "bottom centre", "length and width", "yaw sign", "late"
]
MISTAKES: dict[Mistake, tuple[str, ...]] = {  # and what a finding of each begins with
    "mirrored": ("mirrored",),
    "degrees": ("yaw in degrees where radians", "yaw in radians where degrees"),
    "extents": ("half extents", "doubled extents", "full extents", "half of the half extents"),
    "bottom centre": ("the centre of the floor", "the centre of the roof"),
    "length and width": ("length and width swapped",),
    "yaw sign": ("yaw counted the other way",),
    "late": ("labels lie about",),
}


def make(mistake: Mistake, path: Path, terms: Terms) -> None:
    agents = terms.read(path)
    if mistake == "late":
        made = [
            [samples[k - LATE] if k >= LATE else [] for k in range(len(samples))]
            for samples in agents
        ]
    else:
        made = [
            [
                [replace(row, numbers=_changed(mistake, row.numbers, terms)) for row in rows]
                for rows in samples
            ]
            for samples in agents
        ]
    terms.write(path, made)


def _changed(mistake: Mistake, numbers: np.ndarray, terms: Terms) -> np.ndarray:
    made = numbers.copy()
    half_turn = 180.0 if terms.degrees else np.pi
    if mistake == "mirrored":
        aside = X if terms.camera else Y
        made[aside] = -made[aside]
        made[YAW] = half_turn - made[YAW] if terms.camera else -made[YAW]
    elif mistake == "degrees":
        made[YAW] = np.deg2rad(made[YAW]) if terms.degrees else np.rad2deg(made[YAW])
    elif mistake == "extents":
        made[LENGTH:YAW] *= 2 if terms.halves else 0.5
    elif mistake == "bottom centre":
        height = made[HEIGHT] * (2 if terms.halves else 1)
        # up in a camera's frame: the centre for the floor's
        made[Y if terms.camera else Z] -= height / 2
    elif mistake == "length and width":
        made[[LENGTH, WIDTH]] = made[[WIDTH, LENGTH]]
    else:
        made[YAW] = -made[YAW]
    return made


def _row(numbers: Sequence[Any], record: Any) -> Row:
    return Row(np.array([float(number) for number in numbers]), record)


def _files(folder: Path, *patterns: str) -> list[Path]:
    return sorted(file for pattern in patterns for file in folder.glob(pattern))


def _json(file: Path) -> Any:
    return json.loads(file.read_text())


def _angle(z: float, w: float) -> float:
    return float(2 * np.arctan2(z, w))


def _of_files(
    patterns: tuple[str, ...],
    numbers: Callable[[Any], Sequence[Any]],
    changed: Callable[[Any, np.ndarray], Any],
    *,
    records: Callable[[Any], list[Any]] = list,
    replaced: Callable[[Any, list[Any]], Any] = lambda content, rows: rows,
    load: Callable[[str], Any] = json.loads,
    dump: Callable[[Any], str] = json.dumps,
) -> tuple[Callable[[Path], list[Tables]], Callable[[Path, list[Tables]], None]]:
    """Of layouts with a file per sample; a folder of such files is an agent."""

    def agents(path: Path) -> list[list[Path]]:
        return [
            list(files)
            for _, files in groupby(_files(path, *patterns), key=lambda file: file.parent)
        ]

    def rows_of(file: Path) -> list[Row]:
        return [_row(numbers(each), each) for each in records(load(file.read_text()))]

    def write(path: Path, tables: list[Tables]) -> None:
        for files, samples in zip(agents(path), tables, strict=True):
            for file, rows in zip(files, samples, strict=True):
                made = [changed(deepcopy(row.record), row.numbers) for row in rows]
                file.write_text(dump(replaced(load(file.read_text()), made)))

    return lambda path: [[rows_of(file) for file in files] for files in agents(path)], write


def _of_table(
    load: Callable[[Path], list[Any]],
    dump: Callable[[Path, list[Any]], object],
    key: str,
    samples: Callable[[Path], list[Any]],
    numbers: Callable[[Any], Sequence[Any]],
    changed: Callable[[np.ndarray], dict[str, Any]],
) -> Terms:
    """Of layouts with one table of all boxes, which `key` assigns to samples."""

    def read(path: Path) -> list[Tables]:
        table = load(path)
        return [
            [
                [_row(numbers(each), each) for each in table if each[key] == at]
                for at in samples(path)
            ]
        ]

    def write(path: Path, tables: list[Tables]) -> None:
        pairs = zip(samples(path), tables[0], strict=True)
        dump(
            path,
            [row.record | changed(row.numbers) | {key: at} for at, rows in pairs for row in rows],
        )

    return Terms(read, write)


def _folder() -> Terms:
    names = ("x", "y", "z", "length", "width", "height", "yaw_deg")

    def read(path: Path) -> list[Tables]:
        samples = _json(path / "labels.json")["samples"]
        return [
            [
                [_row([each[name] for name in names], each) for each in sample["objects"]]
                for sample in samples
            ]
        ]

    def write(path: Path, tables: list[Tables]) -> None:
        content = _json(path / "labels.json")
        for sample, rows in zip(content["samples"], tables[0], strict=True):
            sample["objects"] = [
                row.record | dict(zip(names, row.numbers.tolist(), strict=True)) for row in rows
            ]
        (path / "labels.json").write_text(json.dumps(content))

    return Terms(read, write, degrees=True)


def _kitti() -> Terms:
    def load(text: str) -> list[list[str]]:
        return [line.split() for line in text.splitlines() if not line.startswith("DontCare")]

    def numbers(cells: list[str]) -> list[str]:
        return [*cells[11:14], *cells[10:7:-1], cells[14]]

    def changed(cells: list[str], row: np.ndarray) -> list[str]:
        return [
            *cells[:8],
            *(f"{value:.6f}" for value in row[[HEIGHT, WIDTH, LENGTH, X, Y, Z, YAW]]),
        ]

    def dump(lines: list[list[str]]) -> str:
        return "".join(" ".join(cells) + "\n" for cells in lines)

    return Terms(
        *_of_files(("training/label_2/*.txt",), numbers, changed, load=load, dump=dump), camera=True
    )


def _openlabel() -> Terms:
    def records(content: Any) -> list[Any]:
        return list(content["openlabel"]["frames"]["0"]["objects"].items())

    def numbers(pair: Any) -> list[float]:
        value = pair[1]["object_data"]["cuboid"][0]["val"]
        return [*value[:3], *value[7:10], _angle(value[5], value[6])]

    def changed(pair: Any, row: np.ndarray) -> Any:
        half = row[YAW] / 2
        pair[1]["object_data"]["cuboid"][0]["val"] = [
            *row[:3].tolist(),
            0,
            0,
            np.sin(half),
            np.cos(half),
            *row[3:6],
        ]
        return pair

    def replaced(content: Any, pairs: list[Any]) -> Any:
        content["openlabel"]["frames"]["0"]["objects"] = dict(pairs)
        return content

    return Terms(
        *_of_files(
            ("labels_point_clouds/*.json",), numbers, changed, records=records, replaced=replaced
        )
    )


def _dair(*patterns: str) -> Terms:
    def numbers(each: Any) -> list[Any]:
        place, size = each["3d_location"], each["3d_dimensions"]
        return [*(place[axis] for axis in "xyz"), *(size[axis] for axis in "lwh"), each["rotation"]]

    def changed(each: Any, row: np.ndarray) -> Any:
        each["3d_location"] = dict(zip("xyz", row[:3].tolist(), strict=True))
        each["3d_dimensions"] = dict(zip("lwh", row[3:6].tolist(), strict=True))
        return each | {"rotation": float(row[YAW])}

    return Terms(*_of_files(patterns, numbers, changed))


def _sustech() -> Terms:
    def numbers(each: Any) -> list[Any]:
        psr = each["psr"]
        return [
            *(psr["position"][a] for a in "xyz"),
            *(psr["scale"][a] for a in "xyz"),
            psr["rotation"]["z"],
        ]

    def changed(each: Any, row: np.ndarray) -> Any:
        parts = {
            "position": row[:3].tolist(),
            "scale": row[3:6].tolist(),
            "rotation": [0.0, 0.0, float(row[YAW])],
        }
        return each | {
            "psr": {name: dict(zip("xyz", part, strict=True)) for name, part in parts.items()}
        }

    return Terms(*_of_files(("label/*.json",), numbers, changed))


def _opv2v() -> Terms:
    import yaml

    def records(content: Any) -> list[Any]:
        return list(content["vehicles"].items())

    def numbers(pair: Any) -> list[float]:
        return [*pair[1]["location"], *pair[1]["extent"], pair[1]["angle"][1]]

    def changed(pair: Any, row: np.ndarray) -> Any:
        place = {
            "location": row[:3].tolist(),
            "extent": row[3:6].tolist(),
            "angle": [0.0, float(row[YAW]), 0.0],
        }
        return pair[0], pair[1] | place

    def replaced(content: Any, pairs: list[Any]) -> Any:
        return content | {"vehicles": dict(pairs)}

    more: dict[str, Any] = {"load": yaml.safe_load, "dump": yaml.safe_dump}
    own = _of_files(
        ("scenario/*/*.yaml",), numbers, changed, records=records, replaced=replaced, **more
    )
    return Terms(*own, degrees=True, halves=True)


def _nuscenes() -> Terms:
    def numbers(each: Any) -> list[float]:
        size, turn = each["size"], each["rotation"]
        return [*each["translation"], size[1], size[0], size[2], _angle(turn[3], turn[0])]

    def changed(row: np.ndarray) -> dict[str, Any]:
        turn = [float(np.cos(row[YAW] / 2)), 0.0, 0.0, float(np.sin(row[YAW] / 2))]
        return {
            "translation": row[:3].tolist(),
            "size": row[[WIDTH, LENGTH, HEIGHT]].tolist(),
            "rotation": turn,
        }

    def samples(path: Path) -> list[str]:
        return [each["token"] for each in _json(path / "v1.0-coview/sample.json")]

    def dump(path: Path, made: list[Any]) -> None:
        (path / "v1.0-coview/sample_annotation.json").write_text(json.dumps(made))

    def load(path: Path) -> list[Any]:
        return list(_json(path / "v1.0-coview/sample_annotation.json"))

    return _of_table(load, dump, "sample_token", samples, numbers, changed)


def _argoverse() -> Terms:
    import pyarrow
    from pyarrow import feather

    columns = ["tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m"]

    def numbers(each: Any) -> list[float]:
        return [*(each[name] for name in columns), _angle(each["qz"], each["qw"])]

    def changed(row: np.ndarray) -> dict[str, Any]:
        turn = {
            "qw": float(np.cos(row[YAW] / 2)),
            "qx": 0.0,
            "qy": 0.0,
            "qz": float(np.sin(row[YAW] / 2)),
        }
        return dict(zip(columns, row[:6].tolist(), strict=True)) | turn

    def samples(path: Path) -> list[int]:
        return sorted(int(file.stem) for file in _files(path, "sensors/lidar/*.feather"))

    def dump(path: Path, made: list[Any]) -> None:
        feather.write_feather(pyarrow.Table.from_pylist(made), path / "annotations.feather")

    def load(path: Path) -> list[Any]:
        return list(feather.read_table(path / "annotations.feather").to_pylist())

    return _of_table(load, dump, "timestamp_ns", samples, numbers, changed)


def _hdf5() -> Terms:
    import h5py

    columns = [0, 1, 2, 6, 7, 8, 5]

    def read(path: Path) -> list[Tables]:
        with h5py.File(path, "r") as file:
            tables = [file[f"objects/{k}"][()] for k in range(len(file["objects"]))]
            own = zip(file["coview/object_ids"][()], file["coview/object_bodies"][()], strict=True)
        return [[[_row(row[columns], (row, *next(own))) for row in table] for table in tables]]

    def write(path: Path, tables: list[Tables]) -> None:
        with h5py.File(path, "r+") as file:
            for k, rows in enumerate(tables[0]):
                made = np.array([row.record[0] for row in rows]).reshape(-1, 10)
                made[:, columns] = np.array([row.numbers for row in rows]).reshape(-1, 7)
                del file[f"objects/{k}"]
                file[f"objects/{k}"] = made
            for place, name in enumerate(("object_ids", "object_bodies"), 1):
                del file[f"coview/{name}"]
                file[f"coview/{name}"] = np.array(
                    [row.record[place] for rows in tables[0] for row in rows], np.int64
                )
            file["coview/object_start"][()] = np.cumsum([0, *map(len, tables[0])])

    return Terms(read, write, degrees=True, halves=True)


TERMS = {
    "folder": _folder(),
    "kitti": _kitti(),
    "openlabel": _openlabel(),
    "dair": _dair("label/virtuallidar/*.json"),
    "opv2v": _opv2v(),
    "v2xset": _opv2v(),
    "v2xreal": _opv2v(),
    "rcooper": _dair("label/*/*/*/*.json"),
    "nuscenes": _nuscenes(),
    "argoverse": _argoverse(),
    "sustech": _sustech(),
    "hdf5": _hdf5(),
}
