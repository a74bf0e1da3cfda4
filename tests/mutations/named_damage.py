"""Damage that happens, by name, and the line that a user sees: `python
tests/mutations/named_damage.py` prints a table.

Some of its lines are in docs/damaged-inputs.md. Each case spoils a sound file of `formats` and
reads it as a command would.
"""

import json
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

Spoil = Callable[[Path], object]


def lines() -> Iterator[tuple[str, str, str]]:
    """File, what was done, and the message, "read" where it is read all the same."""
    from formats import formats

    every = formats()
    for name, cases in CASES.items():
        for what, spoil in cases.items():
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
                warnings.simplefilter("ignore")
                path = Path(folder, name)
                every[name].make(path)
                spoil(path)
                try:
                    every[name].read(path)
                    yield name, what, "read"
                except (ValueError, OSError) as error:
                    yield name, what, str(error).replace(f"{folder}/", "")


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _text(content: str) -> Spoil:
    return lambda path: path.write_text(content)


def _replaced(old: str, new: str) -> Spoil:
    return lambda path: path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))


def _exchanged(path: Path) -> None:
    """Latitude and longitude of a map change places."""
    path.write_text(re.sub(r'lat="(.*?)" lon="(.*?)"', r'lat="\2" lon="\1"', path.read_text()))


def _hdf5(change: Callable[[h5py.File], Any]) -> Spoil:
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return spoil


def _put(name: str, change: Callable[[np.ndarray], Any]) -> Spoil:
    def swap(file: h5py.File) -> None:
        content = change(file[name][()])
        del file[name]
        file[name] = content

    return _hdf5(swap)


def _rows(column: int, value: float) -> Spoil:
    """All objects of frame 1 with another number in a column."""

    def change(rows: np.ndarray) -> np.ndarray:
        rows[:, column] = value
        return rows

    return _put("objects/1", change)


def _site(layer: str, part: str, **values: Any) -> Spoil:
    def spoil(path: Path) -> None:
        site = json.loads(path.read_text())
        {feature["properties"]["layer"]: feature for feature in site["features"]}[layer][
            part
        ].update(values)
        path.write_text(json.dumps(site))

    return spoil


def _lifted(path: Path) -> None:
    """A sensor of a live project hangs far too high."""
    project = json.loads(path.read_text())
    project["variants"]["A"]["sensors"][0]["height"] = 6000.0
    path.write_text(json.dumps(project))


CASES: dict[str, dict[str, Spoil]] = {
    "recording.hdf5": {
        "cut in half": _cut,
        "no HDF5 file at all": _text("not a dataset"),
        "`dslices` missing": _hdf5(
            lambda file: [file.pop(name) for name in ("dslices", "coview/ranges")]
        ),
        "depth images of another size": _put("dslices", lambda images: images[..., :10]),
        "NaN in an extrinsic": _put("cameras/d00/extrinsic", lambda matrix: matrix * np.nan),
        "objects with seven columns": _put("objects/1", lambda rows: rows[:, :7]),
        "objects that are text": _put("objects/1", lambda rows: rows.astype("S")),
        "NaN in objects": _rows(0, np.nan),
        "half extents of 0": _rows(7, 0.0),
        "half extents of -1": _rows(6, -1.0),
        "half extents of a million metres": _rows(6, 1e6),
        "x of 1e300": _rows(0, 1e300),
        "yaw of 1e18": _rows(5, 1e18),
        "a sensor without a name": _hdf5(
            lambda file: file["cameras/d00"].attrs.__delitem__("name")
        ),
        "two sensors of one name": _hdf5(
            lambda file: file["cameras/d01"].attrs.__setitem__("name", "north")
        ),
    },
    "frames.packed": {
        "cut in half": _cut,
        "pixels outside the image": _put("rigs/0/pixels", lambda pixels: pixels + 10**6),
        "boxes without size": _put("boxes", lambda boxes: boxes * 0),
    },
    "network.safetensors": {
        "cut in half": _cut,
        "another configuration": _replaced("6.4, 6.4]", "6.4, nine"),
    },
    "checkpoint.pt": {"cut in half": _cut},
    "binary.pcd": {"cut in half": _cut, "no z": _replaced("x y z", "x y q")},
    "binary.ply": {"cut in half": _cut},
    "cloud.csv": {"a word among the numbers": _replaced(".", "north")},
    "poses.json": {
        "100,000 brackets": _text("[" * 100_000),
        "a pose that mirrors": _text('{"a": [[1,0,0,0],[0,-1,0,0],[0,0,1,0]]}'),
    },
    "site.json": {
        "cut in half": _cut,
        "NaN in a sensor's position": _site("sensor", "geometry", coordinates=[float("nan"), 0, 5]),
        "a sensor's heading is text": _site("sensor", "properties", heading_deg="north"),
        "a wall whose outline crosses itself": _site(
            "solid", "geometry", coordinates=[[[0, 0], [4, 4], [4, 0], [0, 4], [0, 0]]]
        ),
    },
    "poles.geojson": {
        "100,000 brackets": _text("[" * 100_000),
        "a height that is text": _replaced("6", '"high"'),
        "in another system": _replaced(
            '"coview_site": 1', '"crs": {"properties": {"name": "EPSG:25833"}}'
        ),
    },
    "map.osm": {
        "cut in half": _cut,
        "without roads": _text("<osm version='0.6'></osm>"),
        "latitude and longitude exchanged": _exchanged,
        "Overpass ran out of time": _replaced(
            "</osm>", "<remark>runtime error: Query timed out</remark></osm>"
        ),
    },
    "map.json": {"no list of elements": _text('{"type": "FeatureCollection", "features": []}')},
    "map.xodr": {"cut in half": _cut},
    "table.npz": {"cut in half": _cut},
    "plan.json": {
        "of an earlier coview": _replaced('"coview_plan": 1', '"old": 1'),
        "a pole at x = 1e300": _replaced('"x": ', '"x": 1e300, "was": '),
        "a price that is text": _replaced('"price": 1500.0', '"price": "much"'),
    },
    "live.json": {
        "cut in half": _cut,
        "a sensor that is null": _replaced('"sensors": [', '"sensors": [null, '),
        "a sensor 6,000 m up": _lifted,
    },
    "surrogate.json": {"100,000 brackets": _text("[" * 100_000)},
    "mesh.obj": {"a corner that is not there": _replaced("f 1", "f 99")},
}

if __name__ == "__main__":
    print("| file | what was done | what the user sees |\n|---|---|---|")
    for name, what, line in lines():
        print(f"| {name} | {what} | {line.replace('|', '/')} |")
