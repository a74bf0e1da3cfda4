"""Count the files of the product that one simulated frame passes from HDF5 to AP, and the calls
between them.

A call counts where its caller and its callee lie in two files. The recording is open, its detector
is the truth, and early, late and hybrid fusion of all sensors are scored. Run it as `python
tests/benchmarks/toolkit/bench_calls.py`; `--pairs` lists the calls.
"""

import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

import numpy as np

import toolkit
from coview.recordings import Opening
from toolkit.datasets.recording_views import Reads
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.frame import Recording
from toolkit.objects import Detections
from toolkit.runtime.run import Run

HOUSE = Path(toolkit.__file__).parents[1]
FLOORS = tuple(f"{HOUSE / floor}/" for floor in ("coview", "toolkit", "models", "placement_env"))
MOST_FILES, MOST_CALLS = 20, 200


def count_calls(recording: Recording) -> Counter[tuple[str, str]]:
    """Calls from one file of the product to another while its first frame is scored."""
    calls = Counter[tuple[str, str]]()
    boxes = recording[0].objects.boxes
    found = Detections(boxes, np.linspace(0.9, 0.1, len(boxes)))

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_back is not None:
            pair = frame.f_back.f_code.co_filename, frame.f_code.co_filename
            if pair[0] != pair[1] and all(file.startswith(FLOORS) for file in pair):
                calls[pair] += 1

    sys.setprofile(note)
    evaluate_recording(recording, lambda points: found, Comparison(), reads=Reads(frames=1))
    sys.setprofile(None)
    return calls


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        path = Path(folder) / "one.hdf5"
        simulate_dataset("tjunction", path, run=Run(frames=1))
        for _ in range(2):  # the first run loads what loads on demand
            with Opening().open(path) as opened:
                total = count_calls(opened)
    for pair, number in total.most_common() if "--pairs" in sys.argv else ():
        print(f"{number:4d}", *(Path(file).relative_to(HOUSE) for file in pair))
    files = {file for pair in total for file in pair}
    print(
        f"{len(files)} files (limit {MOST_FILES}), {total.total()} calls between them (limit "
        f"{MOST_CALLS})"
    )
