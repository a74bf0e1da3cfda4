"""Two thousand frames through every long command: memory and open files must not grow with the
frames.

`pytest -s -m slow tests/test_soak.py` prints resident memory (MB) after each quarter of a command's
time, and the most files that it had open; COVIEW_SOAK says how many frames. Sensors are small and
the detector does nothing, so that it takes some fifteen minutes; what a frame leaves behind depends
on neither. Results are written in the last quarter. The frames that `simulate` is watched with are
1 s apart, since continuous traffic is kept whole until all rays are cast.
"""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site, save_site

FRAMES = int(os.environ.get("COVIEW_SOAK", "2000"))
DETECTOR = """
import numpy as np
from toolkit.objects import Detections

def find(points):
    boxes = np.column_stack([points[:3], np.tile([4.4, 1.8, 1.6, 0.3], (len(points[:3]), 1))])
    return Detections(boxes.astype(np.float64), np.linspace(0.9, 0.5, len(boxes)), np.zeros(len(boxes), np.int64))
"""
COMMANDS = (
    f"simulate light.json --frames {FRAMES} --every 1 --workers 1 --out apart.hdf5",
    "survey light.hdf5",
    "detect light.hdf5 --detector cheap:find --level none --out boxes.json",
    "pack light.hdf5 --out light.packed",
    "evaluate light.hdf5 --detector cheap:find --out scores",
    "stress light.hdf5 --detector cheap:find --kinds silent --schemes early --out stress",
    "convert light.hdf5 --to folder --out clouds",
    "survey clouds",
    "convert clouds --to hdf5 --out clouds.hdf5",
    "evaluate clouds.hdf5 --detector cheap:find --out scores_of_clouds",
)
MORE_MB, MORE_FILES = 18, 4  # in the third quarter; images of five hundred frames take 19 MB


@pytest.mark.slow
def test_memory_and_open_files_do_not_grow_with_the_frames(tmp_path):
    site = load_site("tjunction")
    small = DepthCamera(width=160, height=120, stride=2)
    sensors = tuple(replace(sensor, model=small) for sensor in site.sensors[:2])
    light = replace(site, name="light", sensors=sensors)
    save_site(light, tmp_path / "light.json")
    simulate_dataset(light, tmp_path / "light.hdf5", interval=0.5, run=Simulation(frames=FRAMES))
    (tmp_path / "cheap.py").write_text(DETECTOR)
    print(f"\n{FRAMES} frames: seconds, MB after each quarter of the time, most open files")
    print("| command | s | 25 % | 50 % | 75 % | 100 % | files |")
    grown = []
    for command in COMMANDS:
        times, megabytes, files = watch(command, tmp_path)
        quarters = [
            megabytes[times <= times[-1] * share][-len(times) // 8 :].max()
            for share in (0.25, 0.5, 0.75, 1)
        ]
        cells = [f"{times[-1]:.0f}", *(f"{each:.0f}" for each in quarters), f"{files.max()}"]
        print(f"| {' '.join(command.split()[:2])} | {' | '.join(cells)} |", flush=True)
        half, written = len(files) // 2, len(files) * 3 // 4  # results are written at the end
        if (
            quarters[2] > quarters[1] + MORE_MB
            or files[half:written].max() > files[:half].max() + MORE_FILES
        ):
            grown.append(command)
    assert not grown


def watch(command: str, folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run a command; return seconds, resident memory (MB) and the number of open files, of it and
    its children."""
    root = Path(__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": f"{root}:{folder}", "OMP_NUM_THREADS": "1"}
    with (folder / "said").open("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "coview", *command.split()],
            cwd=folder,
            env=environment,
            stdout=said,
            stderr=said,
        )
        start, rows = time.monotonic(), list[tuple[float, float, float]]()
        while process.poll() is None:
            megabytes, files = np.sum([measure(number) for number in family(process.pid)], axis=0)
            rows.append((time.monotonic() - start, megabytes, files))
            time.sleep(0.1)
        said.seek(0)
        assert process.returncode in (0, 1), said.read()
    columns = np.array(rows).T
    return columns[0], columns[1], columns[2].astype(int)


def family(number: int) -> list[int]:
    """Numbers of a process and all below it."""
    try:
        below = Path(f"/proc/{number}/task/{number}/children").read_text().split()
    except OSError:
        below = []
    return [number, *(each for child in below for each in family(int(child)))]


def measure(number: int) -> tuple[float, int]:
    """Resident memory (MB) and open files of a process, 0 of one that is gone."""
    try:
        pages = int(Path(f"/proc/{number}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, len(os.listdir(f"/proc/{number}/fd"))
    except OSError:
        return 0.0, 0
