"""Every command that writes, killed (SIGKILL) at random moments and started again by the same line:
it ends with the files of a run that nobody disturbed, and leaves no other."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL there"),
]
KILLS = int(os.environ.get("COVIEW_KILLS", "10"))
SMALL = "--frames 8 --workers 1"
PLACED = "--budget 2 --candidates paper --frames 8"
COMMANDS = {
    "simulate": f"simulate tjunction {SMALL} --out OUT/x.hdf5",
    "convert": "convert rec.hdf5 --to kitti --out OUT/x",
    "convert folder": "convert rec.hdf5 --to folder --out OUT/x",
    "convert hdf5": "convert rec.hdf5 --to hdf5 --out OUT/x.hdf5",
    "calibrate": (
        "calibrate clouds --layout folder --reference tjunction --out OUT/x --poses OUT/poses.json"
    ),
    "detect": "detect clouds --format openlabel --level map --out OUT/x",
    "evaluate": "evaluate rec.hdf5 --frames 8 --schemes early late --out OUT/x",
    "stress": (
        "stress rec.hdf5 --frames 6 --schemes early --kinds pose silent --cache OUT/c --out OUT/x"
    ),
    "table": "table rec.hdf5 --frames 2 --out OUT/x.npz",
    "pack": "pack rec.hdf5 --out OUT/x.packed",
    "pack random": f"pack --random-sites 3 {SMALL} --out OUT/x.packed",
    "train": "train --data x.packed --epochs 2 --batch 2 --device cpu --checkpoint-s 0.01 --out OUT/x",
    "search": f"search tjunction {PLACED} --judge surrogate --cache OUT/c --out OUT/x",
    "plan": f"plan tjunction {PLACED} --cache OUT/c --workers 1 --out OUT/x",
    "surrogate": (
        "surrogate tjunction --frames 6 --poses 2 --sets 4 --schemes early --cache OUT/c --out "
        "OUT/x.json"
    ),
    "track": "track seq.hdf5 --out OUT/x.json",
    "track mcap": "track seq.hdf5 --to mcap --out OUT/x.mcap",
    "track several": ("track seq.hdf5 --to detection3d openlabel osi --out OUT/x"),
    "count": "count seq.hdf5 --tracks tracks.json --out OUT/x.csv --diagram OUT/x.svg",
    "conflicts": "conflicts seq.hdf5 --tracks tracks.json --out OUT/x.csv",
    "label": "label seq.hdf5 --tracks tracks.json --out OUT/x",
    "export": "export general OUT/x.onnx --area -20 -20 20 20",
    "accept": "accept rec.hdf5 --plan plan --out OUT/x",
    "view": "view rec.hdf5 --out OUT/x.html",
    "site": "site random --seed 3 --out OUT/x.json",
}
# written whole in one go: the later run's stays
ONE_FILE = ("track", "track mcap", "count", "conflicts", "export", "view", "site")
KEPT = {"c"}  # folders of intermediate results


def start(line: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "coview", *line.split()],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": str(Path(__file__).parents[1]),
            "PYTHONWARNINGS": "ignore",
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(line: str, folder: Path) -> tuple[int, str]:
    process = start(line, folder)
    said = process.communicate()[1]
    return process.returncode, said


def files(folder: Path) -> list[str]:
    below = (each.relative_to(folder) for each in folder.rglob("*") if each.is_file())
    return sorted(str(each) for each in below if each.parts[0] not in KEPT)


@pytest.fixture(scope="session")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kills")
    for line in (
        "simulate tjunction --frames 8 --seed 3 --workers 1 --out rec.hdf5",
        "convert rec.hdf5 --to folder --out clouds",
        "pack rec.hdf5 --out x.packed",
        "simulate tjunction --frames 8 --every 0.1 --seed 3 --workers 1 --out seq.hdf5",
        "track seq.hdf5 --out tracks.json",
        f"plan tjunction {PLACED} --workers 1 --out plan",
    ):
        code, said = finish(line, folder)
        assert code in (0, 1), said  # 1 is a plan's no
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_killed_at_any_moment_is_resumed_by_the_same_line(place, tmp_path, name):
    def line(number):
        (tmp_path / str(number)).mkdir()
        return COMMANDS[name].replace("OUT", str(tmp_path / str(number)))

    whole = line("whole")
    before = time.monotonic()
    code, said = finish(whole, place)
    took = time.monotonic() - before
    assert code in (0, 1), said
    expected, draw, alive = files(tmp_path / "whole"), random.Random(name), 0
    for number in range(KILLS):
        killed = line(number)
        process = start(killed, place)
        with suppress(subprocess.TimeoutExpired):
            process.wait(took * draw.uniform(0.3, 1.0))
        alive += process.poll() is None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        found = files(tmp_path / str(number))
        again, said = finish(killed, place)
        # killed after its work was done
        done = again == 2 and "exists" in said and found == expected
        assert again == code or done, (number, said, found)
        assert "Traceback" not in said
        assert files(tmp_path / str(number)) == expected, (number, found)
    assert alive, "no run was killed: it ended before"
    print(f"{name}: {KILLS} kills, {alive} of a living process, all resumed")


@pytest.mark.parametrize("name", ONE_FILE)
def test_of_two_runs_at_once_the_later_one_stays(place, tmp_path, name):
    both = [start(COMMANDS[name].replace("OUT", str(tmp_path)), place) for _ in range(2)]
    said = [process.communicate()[1] for process in both]
    for process, text in zip(both, said, strict=True):
        assert process.returncode == 0 or "exists: write" in text, text
    assert not [each for each in files(tmp_path) if "unfinished" in each or "lock" in each]


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ONE_FILE])
def test_of_two_runs_at_once_one_is_refused_in_one_line(place, tmp_path, name):
    both = [start(COMMANDS[name].replace("OUT", str(tmp_path)), place) for _ in range(2)]
    said = {process: process.communicate()[1] for process in both}
    done, refused = sorted(both, key=lambda process: process.returncode)
    assert done.returncode in (0, 1), said[done]
    assert refused.returncode == 2, said[refused]
    assert re.search("another run is writing|exists: write", said[refused]), said[refused]
    assert "Traceback" not in said[refused] + said[done]
    assert not [each for each in files(tmp_path) if "unfinished" in each or "lock" in each]
