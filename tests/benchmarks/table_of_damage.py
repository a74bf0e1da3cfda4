"""Damage inputs in every way the docs list and print, as a table, what the user sees.

python tests/benchmarks/table_of_damage.py
"""

import contextlib
import io
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import h5py
import numpy as np

import coview
from coview import main as command_line

Damage = Callable[[Path], None]


def main() -> None:
    """One row per kind of damage."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        run("simulate", "tjunction", "--frames", "3", "--seed", "1", "--out", "good.hdf5", "--workers", "1")
        site = json.loads(Path(coview.__file__).parents[1].joinpath("toolkit/sites/tjunction.json").read_text())
        print("| what was done | command | exit code | what the user sees |\n|---|---|---|---|")
        for what, damage in DATASETS.items():
            shutil.copy("good.hdf5", "bad.hdf5")
            damage(Path("bad.hdf5"))
            row(what, "evaluate", "bad.hdf5", "--iou", "0.7", "--out", "out")
        for what, change in SITES.items():
            damaged = json.loads(json.dumps(site))
            change(damaged)
            Path("bad.json").write_text(json.dumps(damaged))
            row(what, "simulate", "bad.json", "--frames", "1", "--out", "x.hdf5")
        Path("bad.json").write_text(json.dumps(site)[:9000])
        row("site file cut off", "simulate", "bad.json", "--frames", "1", "--out", "x.hdf5")
        row("unknown sensor id", "evaluate", "good.hdf5", "--sensors", "0,17", "--out", "out")
        row("unknown site", "simulate", "atlantis", "--out", "x.hdf5")
        row("another seed over a finished file", "simulate", "tjunction", "--frames", "3", "--out", "good.hdf5")
        with mock.patch.dict(sys.modules, {"libsumo": None}):
            row("SUMO not installed", "simulate", "tjunction", "--frames", "1", "--out", "x.hdf5", "--workers", "1")
        Path("empty.osm").write_text("<osm version='0.6'></osm>")
        place = ("--centre", "8", "50", "--size", "80", "60", "--out", "x.json")
        row("map without roads", "site", "import", "--osm", "empty.osm", *place)


def row(what: str, *arguments: str) -> None:
    """Run a command and print what it ends with."""
    code, said = run(*arguments)
    lines = [line for line in said.replace("\r", "\n").splitlines() if line.strip()]
    print(f"| {what} | `coview {' '.join(arguments)}` | {code} | {lines[-1].strip().replace('|', '/')} |")


def run(*arguments: str) -> tuple[int, str]:
    """Exit code and everything printed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = command_line.run(arguments)
    return code, printed.getvalue()


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _edit(change: Callable[[h5py.File], None]) -> Damage:
    def damage(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return damage


def _reshape(file: h5py.File) -> None:
    images = file["dslices"][:, :, :100]
    del file["dslices"]
    file["dslices"] = images


def _blank(file: h5py.File) -> None:
    file["dslices"][:] = 0


def _extrinsic(value: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        camera = next(iter(file["cameras"].values()))
        camera["extrinsic"][0, :3] = value

    return change


def _objects(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[h5py.File], None]:
    def replace(file: h5py.File) -> None:
        for k in list(file["objects"]):
            rows = change(file["objects"][k][:])
            del file["objects"][k]
            file["objects"][k] = rows

    return replace


def _first(layer: str, change: Callable[[dict], None]) -> Callable[[dict], None]:
    def damage(site: dict) -> None:
        change(next(f for f in site["features"] if f["properties"]["layer"] == layer))

    return damage


def _cross(feature: dict) -> None:
    feature["geometry"]["coordinates"] = [[[0, 0], [4, 4], [4, 0], [0, 4], [0, 0]]]


DATASETS: dict[str, Damage] = {
    "file cut in half": _cut,
    "no HDF5 file at all": lambda path: path.write_text("not a dataset"),
    "depth images of the wrong shape": _edit(_reshape),
    "`dslices` missing": _edit(lambda file: file.__delitem__("dslices")),
    "NaN in an extrinsic": _edit(_extrinsic(np.nan)),
    "singular extrinsic": _edit(_extrinsic(0.0)),
    "objects with seven columns": _edit(_objects(lambda rows: rows[:, :7])),
    "NaN in objects": _edit(_objects(lambda rows: rows * np.nan)),
    "no objects in any frame": _edit(_objects(lambda rows: rows[:0])),
    "empty frames (no return at all)": _edit(
        lambda file: file["dslices"].write_direct(np.zeros(file["dslices"].shape, "f4"))
    ),
}
SITES: dict[str, Callable[[dict], None]] = {
    "site: building whose outline crosses itself": _first("solid", _cross),
    "site: NaN in a sensor's position": _first(
        "sensor", lambda feature: feature["geometry"].update(coordinates=[np.nan, 0, 5])
    ),
    "site: sensor's heading is text": _first(
        "sensor", lambda feature: feature["properties"].update(heading_deg="north")
    ),
    "site: no detection area": lambda site: site["features"].pop(0),
}  # fmt: skip

if __name__ == "__main__":
    main()
