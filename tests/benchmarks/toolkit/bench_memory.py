"""Peak memory of `coview simulate` and `coview evaluate`: it must not grow with the number of
frames.

python tests/benchmarks/toolkit/bench_memory.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

FRAMES = (50, 200)


def main() -> None:
    """Each command in a process of its own, for a few and for four times as many frames."""
    with tempfile.TemporaryDirectory() as folder:
        for frames in FRAMES:
            file, out = str(Path(folder, f"{frames}.hdf5")), str(Path(folder, "out"))
            simulate = (
                "simulate",
                "tjunction",
                "--frames",
                str(frames),
                "--out",
                file,
                "--workers",
                "1",
                "--json",
            )
            evaluate = (
                "evaluate",
                file,
                "--schemes",
                "early",
                "--out",
                out,
                "--overwrite",
                "--json",
            )
            print(
                f"{frames:>5} frames: simulate {peak_mb(simulate):.0f} MB, evaluate "
                f"{peak_mb(evaluate):.0f} MB"
            )


CHILD = """
import resource, sys
from coview.main import main
try:
    main(sys.argv[1:])
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_mb(command: tuple[str, ...]) -> float:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *command], check=True, capture_output=True, text=True
    )
    return int(done.stdout.split()[-1]) * 1024 / 1e6


if __name__ == "__main__":
    main()
