"""No damaged file makes a traceback, a crash or a hang, and none is touched: some dozens of mutants,
or very many."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from toolkit.datasets.recordings import LAYOUTS as LAYOUT_NAMES

HERE = Path(__file__).parent
ONE_HALF = (
    "recording.hdf5 frames.packed network.safetensors classes.safetensors card.onnx "
    "checkpoint.pt published.pth table.npz"
)
OTHER_HALF = (
    "published.hdf5 .ply .pcd cloud.npz .xyz .csv .npy .bin .feather poses site.json poles map. "
    "surrogate sqlite .obj plan.json live.json plan-site.json result.json .png .jpg .stl .off "
    ".glb .gltf .toml .las .laz tracks detections.txt flow.csv .message"
)
HALVES = (ONE_HALF.split(), OTHER_HALF.split())
LAYOUTS = ("in-",)  # a file of a recording in each layout


def run(mutants: int, wanted: Sequence[str], *options: str) -> None:
    done = subprocess.run(
        [sys.executable, HERE / "run.py", str(mutants), *options, "--formats", *wanted],
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    print(done.stdout)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"


def test_some_mutants_of_every_format():
    """In one process, as what it imports takes as long as what it reads."""
    run(8, [*HALVES[0], *HALVES[1], *LAYOUTS])


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [*HALVES, LAYOUTS])
def test_very_many_mutants_of_every_format(wanted):
    run(3200, wanted)
    run(3200, wanted, "--structured")


@pytest.mark.slow
def test_what_is_no_file_is_refused_in_the_place_of_each():
    run(1, [""], "--places")


@pytest.mark.slow
def test_every_layout_has_damaged_files_and_the_halves_are_all_formats():
    text = printed(
        "from layout_formats import FILES, NAMED; print(*{NAMED.get(f[0], f[0]) for f in "
        "FILES.values()})"
    )
    assert set(text.split()) == set(LAYOUT_NAMES)
    for name in printed("from formats import formats; print(*formats())").split():
        assert sum(any(part in name for part in half) for half in (*HALVES, LAYOUTS)) == 1, name


def printed(code):
    """What some code prints beside the scripts."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=HERE,
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": str(HERE.parents[1])},
    ).stdout


def test_named_damage_is_one_line_each():
    done = subprocess.run(
        [sys.executable, HERE / "named_damage.py"], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    # Open3D prints as well
    _, _, *rows = (line for line in done.stdout.splitlines() if line.startswith("|"))
    assert len(rows) > 35
    for row in rows:
        assert row.count(" | ") == 2, row
        assert not row.endswith("| read |"), row
        assert "Traceback" not in row, row
