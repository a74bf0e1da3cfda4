"""The doctor on every layout: which of the classic mistakes, made in the files themselves, it
finds.

python tests/benchmarks/toolkit/bench_doctor.py [RECORDING.hdf5 ...] [--layouts kitti dair ...]
[--samples 10]

A simulated recording, whose truth is known, is written in each layout as two lidars on poles; each
mistake is made in the files (`written_mistakes`), and what `coview doctor --layout` says of them is
printed: `found` where it names that mistake and nothing else. Recordings made with `coview simulate
--every 0.1`; without any, both built-in sites and a random one are simulated first.
"""

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from hashlib import blake2b
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from written_mistakes import LATE, MISTAKES, TERMS, Mistake, make

from toolkit.calibration.ground import Ground, level
from toolkit.datasets.box_frames import move_boxes
from toolkit.datasets.cloud_records import write_cloud
from toolkit.datasets.layouts.dair import written_labels
from toolkit.datasets.recordings import LAYOUTS, open_recording, write_recording
from toolkit.doctor import box_fits
from toolkit.doctor.labels import diagnose_labels
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Objects

PLACE = pose(600.0, 1600.0, 30.0, yaw=0.7)  # of the world in the map, where a layout has one
FIRST = 1_700_000_000.0  # s, time of the first sample
IMAGES = "hdf5, by its images"  # `coview doctor` without --layout
# of traffic, by the site or the seed of a random one
SEEDS = {"tjunction": 7, "roundabout": 7, "3": 7}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument(
        "--layouts", nargs="*", default=[*(name for name in LAYOUTS if TERMS.get(name)), IMAGES]
    )
    parser.add_argument("--samples", type=int, default=10)
    parser.add_argument(
        "--recorded-as", default="hdf5", help="the layout of the recordings, such as argoverse"
    )
    given = parser.parse_args()
    # the clouds stay as they are, and so does their ground
    vars(box_fits).update(level=remembered(level))
    with tempfile.TemporaryDirectory() as folder:
        for recording in given.recordings or simulated(Path(folder), given.samples):
            print(f"\n{recording.stem}, {given.samples} samples\n")
            print(
                f"| layout | untouched | {' | '.join(MISTAKES)} |\n|{'---|' * (2 + len(MISTAKES))}",
                flush=True,
            )
            samples = [*islice(open_recording(recording, given.recorded_as), given.samples)]
            for layout in given.layouts:
                row = verdicts(layout, recording, two_lidars(samples), Path(folder, "written"))
                print(f"| {layout} |", *(f"{cell} |" for cell in row), flush=True)


def remembered(find: Callable[..., Ground]) -> Callable[..., Ground]:
    """The same function, which finds the ground of a cloud once."""
    known: dict[bytes, Ground] = {}

    def remembering(points: np.ndarray, **given: Any) -> Ground:
        key = blake2b(np.ascontiguousarray(points).tobytes()).digest()
        if key not in known:
            known[key] = find(points, **given)
        return known[key]

    return remembering


def simulated(folder: Path, frames: int) -> Iterator[Path]:
    """Recordings of the built-in sites and of a random one, at 10 Hz."""
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.runtime.run import Run
    from toolkit.sites.files import load_site
    from toolkit.sites.random import random_site

    for name, seed in SEEDS.items():
        site, out = (
            random_site(int(name)) if name.isdigit() else load_site(name),
            folder / f"{name}.hdf5",
        )
        simulate_dataset(site, out, run=Run(frames=frames, seed=seed), interval=0.1)
        yield out


def two_lidars(samples: Sequence[Frame]) -> list[Frame]:
    """The samples with every second point of half of the sensors as one lidar's, and of the others
    as another's, each level at the place of its first sensor; with times since 1970 and a place in
    a map."""
    made = []
    for sample in samples:
        half = (len(sample.clouds) + 1) // 2
        parts = [part for part in (sample.clouds[:half], sample.clouds[half:]) if part]
        clouds = tuple(
            _lidar(name, part) for name, part in zip(("106", "105"), parts, strict=False)
        )
        made.append(
            Frame.of_clouds(
                sample.name, clouds, sample.objects, time=FIRST + sample.time, map_SE3_world=PLACE
            )
        )
    return made


def _lidar(name: str, clouds: Sequence[SensorCloud]) -> SensorCloud:
    placed = pose(*clouds[0].world_SE3_sensor[:3, 3].tolist(), yaw=0.3 + float(name) % 2)
    points = np.concatenate([cloud.in_world()[::2] for cloud in clouds])
    return SensorCloud(name, transform(invert(placed), points).astype(np.float32), placed)


def write_layout(samples: Sequence[Frame], path: Path, layout: str) -> None:
    """Samples in a layout, also in the one that is only read."""
    if LAYOUTS[layout].writer is not None:
        write_recording(samples, path, layout)
        return
    for sample in samples:
        for cloud in sample.clouds:
            local = move_boxes(invert(cloud.world_SE3_sensor), sample.objects.boxes)
            own = Frame.of_clouds(
                sample.name, (), Objects(local, sample.objects.labels, sample.objects.ids)
            )
            label = path / "label/106-105" / cloud.name / "seq-1" / f"{sample.time:.3f}.json"
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text(json.dumps(written_labels(own)))
            write_cloud(
                path / "data/106-105" / cloud.name / "seq-1/lidar" / f"{sample.time:.3f}.pcd", cloud
            )
            calib = path / "calib/lidar2world" / f"{cloud.name}.json"
            calib.parent.mkdir(parents=True, exist_ok=True)
            placed = cloud.world_SE3_sensor
            calib.write_text(
                json.dumps(
                    {"rotation": placed[:3, :3].tolist(), "translation": placed[:3, 3].tolist()}
                )
            )


def verdicts(layout: str, recording: Path, samples: Sequence[Frame], path: Path) -> Iterator[str]:
    """What is said of a layout's files untouched, then with each mistake."""
    terms = TERMS.get(layout.split(",")[0])
    assert terms is not None, layout
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    where = path
    if terms is TERMS.get("hdf5"):
        where = Path(shutil.copy(recording, path / "recording.hdf5"))
    else:
        write_layout(samples, path, layout)
    untouched = terms.read(where)
    for mistake in (None, *MISTAKES):
        if mistake == "late" and len(samples) <= LATE + 1:
            yield "too few samples"
            continue
        if mistake is not None:
            terms.write(where, untouched)
            make(mistake, where, terms)
        if layout == IMAGES:
            said = [finding.suspected for finding in diagnose_file(where)]
        else:
            chosen = islice(open_recording(where, layout), len(samples))
            said = [finding.suspected for finding in diagnose_labels(chosen)]
        yield verdict(mistake, said)


def verdict(mistake: Mistake | None, said: Iterable[str]) -> str:
    """In a word or two, whether a mistake, or none, is what is suspected."""
    # the first ones
    said = [each for each in said if not (mistake == "late" and each == "frames without objects")]
    if mistake is None:
        return "; ".join(said) or "nothing"
    right = [each for each in said if each.startswith(MISTAKES[mistake])]
    if right and len(said) == 1:
        return "found"
    return "; ".join(said) or "not found"


if __name__ == "__main__":
    main()
