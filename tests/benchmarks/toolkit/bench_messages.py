"""Bytes of foreground messages at both built-in sites.

    python tests/benchmarks/toolkit/bench_messages.py [--frames 1000] [--folder out/messages]
        [--differences]

Of each site two recordings are simulated: 128 frames of the day before, of which the sensors learn
their empty scenes, and frames 0.1 s apart. Every frame's row is kept in the folder as soon as it is
there: killed and started again it goes on, `--print` prints what there is. Intervals: bootstrap
over blocks of 50 frames, in which traffic is the same. Milliseconds are processor time, on one
thread.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from examples.differences.messages import DifferenceReader, DifferenceSender
from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.calibration.recording_scenes import Scenes
from toolkit.calibration.scene_files import load_empty_scenes, save_empty_scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import read_frame
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.link.foreground import decode_foreground, encode_foreground, encode_in_packet
from toolkit.detection.link.foreground_pixels import standing_out
from toolkit.detection.view import Captured
from toolkit.exchange.geonetworking import PACKET_BYTES
from toolkit.runtime.run import Run

sys.path.insert(0, str(Path(__file__).parents[3]))

SITES = ("tjunction", "roundabout")
SEED, DAY_BEFORE, BLOCK = 1418, 128, 50
TIMED = 100  # frames whose messages are read as well
# s between frames of the day before, and between those whose bytes are counted
APART, CLOSE = (5.0, 0.1)


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--frames", type=int, default=50)
    arguments.add_argument("--folder", type=Path, default=Path("out/messages"))
    arguments.add_argument("--differences", action="store_true")
    arguments.add_argument("--print", action="store_true", dest="printed")
    asked = arguments.parse_args()
    for site in () if asked.printed else SITES:
        count_bytes(asked.folder, site, asked.frames, differences=asked.differences)
    print_bytes(asked.folder)


def recorded(folder: Path, site: str, apart: float, frames: int, seed: int = SEED) -> Any:
    """A recording, simulated if it is not there yet."""
    path = folder / f"{site}-{apart:g}-{seed}-{frames}.hdf5"
    if not path.exists():
        simulate_dataset(site, path, run=Run(frames=frames, seed=seed), interval=apart)
    return CoopDataset(path)


def learnt(folder: Path, site: str) -> tuple[Any, ...]:
    path = folder / f"{site}.npz"
    if not path.exists():
        save_empty_scenes(
            path, learn_empty_scenes(recorded(folder, site, APART, DAY_BEFORE, SEED + 1))
        )
    return load_empty_scenes(path)


def links(*, differences: bool) -> dict[str, Any]:
    """What makes the messages of a sensor with an empty scene, and what reads them, by name in
    rows. differences: with `examples/differences` too."""

    def whole(step: float) -> Any:
        return lambda scene: (
            lambda image, missing: encode_foreground(image, scene, missing, step=step),
            lambda message: decode_foreground(message, scene),
        )

    def less(step: float, refers_to: Any, every: int) -> Any:
        def made(scene: Any) -> Any:
            sender = DifferenceSender(scene, step=step, refers_to=refers_to, key_every=every)
            return sender.write, DifferenceReader(scene).read

        return made

    def fitting(scene: Any) -> Any:
        return (
            lambda image, missing: encode_in_packet(image, scene, missing),
            lambda message: decode_foreground(message, scene),
        )

    made = {f"foreground {cm} cm": whole(cm / 100) for cm in (2, 4, 8)}
    made["foreground 2 to 32 cm, as fits"] = fitting
    if not differences:
        return made
    made |= {f"differences {cm} cm": less(cm / 100, "previous", 10) for cm in (2, 4, 8)}
    others: tuple[tuple[Any, int], ...] = (("key", 10), ("previous", 50))
    return made | {f"differences 2 cm, {to} {every}": less(0.02, to, every) for to, every in others}


def count_bytes(folder: Path, site: str, frames: int, *, differences: bool) -> None:
    """Rows of bytes per sensor, and of the first frames milliseconds to choose, encode and
    decode."""
    path = folder / f"{site}-{CLOSE:g}-bytes.jsonl"
    begin = len(list(as_rows(path))) // BLOCK * BLOCK  # links begin anew with traffic
    if begin >= frames:
        return
    kept = path.read_text().splitlines(keepends=True)[:begin] if path.exists() else []
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(kept))
    recording = recorded(folder, site, CLOSE, frames)
    scenes = Scenes(recording, learnt(folder, site))
    for k in range(begin, frames):
        frame = read_frame(recording, k)
        if k == begin or k % BLOCK == 0:
            made = links(differences=differences)
            ends = {
                name: [make(scenes(n)) for n in range(len(frame.sensors))]
                for name, make in made.items()
            }
        row: dict[str, Any] = {
            "bytes": {name: [] for name in ends},
            "ms": {name: [] for name in ends},
            "pixels": [],
        }
        for number in range(len(frame.sensors)):
            captured = Captured(frame, number, recording.site)
            assert captured.pixels is not None
            start = process_time()
            out = standing_out(captured, scenes(number))
            image = captured.sending(out.pixels)
            chosen = process_time() - start
            row["pixels"].append([len(out.pixels), int(out.missing.sum())])
            for name, (write, read) in ((name, each[number]) for name, each in ends.items()):
                start = process_time()
                message = write(image, out.missing)
                written = process_time()
                row["bytes"][name].append(len(message))
                if k < TIMED:
                    read(message)
                    ms = (chosen + written - start, process_time() - written)
                    row["ms"][name].append([round(1e3 * each, 3) for each in ms])
        append(path, row)


def print_bytes(folder: Path) -> None:
    heads = (
        f"{'frames':>6s} {'kbit':>7s} {'95 %':>14s} {'largest':>8s} {'one packet':>10s} "
        f"{'ms':>6s} {'95 %':>6s}"
    )
    for site in SITES:
        rows = list(as_rows(folder / f"{site}-{CLOSE:g}-bytes.jsonl"))
        if not rows:
            continue
        sent, missing = np.array([row["pixels"] for row in rows]).reshape(-1, 2).mean(axis=0)
        print(
            f"\n{site}, {CLOSE:g} s apart: of a sensor {sent:.0f} pixels stand out, {missing:.2f} "
            "are missing"
        )
        print(f"{'':32s} {heads}")
        for name in rows[0]["bytes"]:
            sizes = np.array([row["bytes"][name] for row in rows])
            kbit = 8 * sizes.mean(axis=1) / 1000
            low, high = np.quantile(
                [np.average(kbit, weights=times) for times in draws(len(rows))], (0.025, 0.975)
            )
            ms = (
                np.array([each for row in rows for each in row["ms"][name]])
                .reshape(-1, 2)
                .sum(axis=1)
            )
            spread = f"{kbit.mean():7.3f} {low:6.3f}-{high:7.3f} {8 * sizes.max() / 1000:8.1f}"
            took = f"{np.median(ms):6.2f} {np.quantile(ms, 0.95):6.2f}"
            print(
                f"{name:32s} {len(rows):6d} {spread} {(sizes <= PACKET_BYTES).mean():10.4f} {took}"
            )


def as_rows(path: Path) -> Iterator[dict[str, Any]]:
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except ValueError:
            return


def append(path: Path, row: dict[str, Any]) -> None:
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")


def draws(frames: int, resamples: int = 300) -> Iterator[np.ndarray]:
    """How often each frame is drawn: blocks of traffic, with replacement."""
    rng, blocks = np.random.default_rng(0), np.arange(frames) // BLOCK
    for _ in range(resamples):
        yield np.bincount(
            rng.integers(0, blocks[-1] + 1, blocks[-1] + 1), minlength=blocks[-1] + 1
        )[blocks]


if __name__ == "__main__":
    main()
