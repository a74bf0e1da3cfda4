"""`coview adapt` in altered worlds, against the same network trained as long with the truth.

    python tests/benchmarks/models/bench_adapt.py [rows16 rows128 foreign poor import] [--frames
        400] [--start general] [--seconds 900] [--seed 11]

Recordings of two frames a second, of other seeds to train and to test: lidars of 16 and of 128
rows, cars of the catalogue that no network was trained on, the error profile `poor`, and an
imported map. AP is the mean over classes and IoU thresholds (vehicle 0.7 / 0.8, heavy 0.5, others
0.25 / 0.5), early fusion of all sensors; F1 the mean over classes at the detector's own thresholds,
at the IoU from which a detection is true. The gap is that of AP.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT))

WORLDS = ("rows16", "rows128", "foreign", "poor", "import")
IOUS = {"vehicle": (0.7, 0.8), "heavy": (0.5,), "cyclist": (0.25, 0.5), "pedestrian": (0.25, 0.5)}


def lidars(site, rows):
    """Lidars at every second post of a site's sensors."""
    from toolkit.geometry import pose
    from toolkit.sensors.models import SpinningLidar
    from toolkit.sensors.sensor import Sensor

    model = SpinningLidar(channels=rows, fov_up=0.0)
    return tuple(
        Sensor(f"l{k}", model, pose(*each.position)) for k, each in enumerate(site.sensors[::2])
    )


def simulate(world, folder, frames, seed):
    """Record a world; return the site's file, if any, and the recordings to train and to test."""
    from coview.main import run
    from toolkit.bodies.fleet import fleet_named
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.runtime.run import Simulation
    from toolkit.sites.files import load_site

    file = None
    if world == "import":
        file = folder / "site.json"
        osm = [
            "--osm",
            str(ROOT / "docs/own-junction.osm"),
            "--centre",
            "8.0",
            "49.5",
            "--size",
            "64",
            "48",
        ]
        assert (
            run(["site", "import", *osm, "--out", str(file), "--sensors", "5", "--seed", "3"]) == 0
        )
    site = load_site(file or "tjunction")
    more = {"sensors": lidars(site, int(world[4:]))} if world.startswith("rows") else {}
    more |= {"fleet": fleet_named("catalogue", held_out=True)} if world == "foreign" else {}
    for name, own, count in (("train", seed, frames), ("test", seed + 1, frames // 2)):
        run_of = Simulation(frames=count, seed=own)
        simulate_dataset(
            site, folder / f"{name}.hdf5", run=run_of, interval=0.5, strays=0.2, **more
        )
    return file, folder / "train.hdf5", folder / "test.hdf5"


def level(path, site, errors, seed):
    """Clouds and objects of each frame on level ground."""
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.datasets.recording_views import read_frame
    from toolkit.geometry import level_rows
    from toolkit.points import frame_points

    dataset = CoopDataset(path) if site is None else CoopDataset(path, site=site)
    slope = dataset.site.relief.slope
    for k in range(len(dataset)):
        frame = read_frame(dataset, k, errors=errors, noise_seed=seed)
        clouds = [level_rows(each, slope) for each in frame_points(frame, area=dataset.site)]
        yield clouds, replace(frame.objects, boxes=level_rows(frame.objects.boxes, slope))


def judge(network, frames, area):
    """Mean AP and mean F1."""
    from models.detector import VoxelNetDetector
    from toolkit.detection.metrics import TRUE_IOU, evaluate
    from toolkit.objects import label_index
    from toolkit.points import has_centre_inside

    unsure, own = VoxelNetDetector(network, score_threshold=0.05), VoxelNetDetector(network)
    points, truths = zip(
        *((np.concatenate(clouds), objects) for clouds, objects in frames), strict=True
    )
    inside = [has_centre_inside(each.boxes, np.array(area)) for each in truths]
    sure, everything = ([detect(each) for each in points] for detect in (own, unsure))
    ap, f1, said = [], [], []
    for label, ious in IOUS.items():
        true = TRUE_IOU[label_index(label)]
        above = evaluate(sure, truths, iou_thresholds=(true,), counted=inside, label=label)[true]
        f1.append(2 * above.precision * above.recall / max(above.precision + above.recall, 1e-9))
        for iou, row in evaluate(
            everything, truths, iou_thresholds=ious, counted=inside, label=label
        ).items():
            ap.append(row.ap)
            said.append(f"{label}@{iou} {row.ap:.3f}")
    return float(np.mean(ap)), float(np.mean(f1)), " ".join(said)


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("worlds", nargs="*", default=list(WORLDS))
    arguments.add_argument("--frames", type=int, default=400)
    arguments.add_argument("--start", default="general")
    arguments.add_argument("--seconds", type=float, default=900.0)
    arguments.add_argument(
        "--seed", type=int, default=11, help="of the traffic to train on; the test has the next"
    )
    asked = arguments.parse_args()

    import torch

    from coview.commands.detection.train import Adaptation, adapt
    from coview.recordings import Opening
    from models.detector import relocate, weights_file
    from models.training.adaptation import train_further
    from models.training.loop import Machine
    from models.training.packing import pack, sample_recordings
    from models.weight_files import load_weights
    from toolkit.sites.files import load_site

    torch.set_num_threads(1)
    print("| world | start AP, F1 | adapted | with the truth | share of the gap | minutes |")
    print("|---|---|---|---|---|---|", flush=True)
    for world in asked.worlds:
        with TemporaryDirectory() as name:
            folder, errors = Path(name), "poor" if world == "poor" else "paper"
            file, train, test = simulate(world, folder, asked.frames, asked.seed)
            site = None if file is None else load_site(file)
            area = tuple((site or load_site("tjunction")).area.tolist())
            began = time.monotonic()
            opening = Opening(site=None if file is None else str(file))
            settings = Adaptation(asked.start, asked.seconds, errors=errors)
            adapt(train, out=folder / "adapted", settings=settings, opening=opening)
            minutes = (time.monotonic() - began) / 60
            true = [
                (tuple(f"s{k}" for k in range(len(clouds))), clouds, objects, area)
                for clouds, objects in level(train, site, errors, 5)
            ]
            pack(sample_recordings(true[: len(true) - len(true) // 4]), folder / "a.packed")
            start = relocate(load_weights(weights_file(asked.start))[0], area, "general").eval()
            best = train_further(
                start, folder / "a.packed", folder / "truth", Machine(seconds=asked.seconds)
            )
            own = relocate(
                load_weights(folder / "adapted" / "weights.safetensors")[0], area, "general"
            ).eval()
            frames = list(level(test, site, errors, 6))
            figures = [judge(network, frames, area) for network in (start, own, best)]
            gap = (figures[1][0] - figures[0][0]) / (figures[2][0] - figures[0][0])
            shown = " | ".join(f"{ap:.4f}, {f1:.4f}" for ap, f1, _ in figures)
            print(f"| {world} | {shown} | {gap:.2f} | {minutes:.1f} |", flush=True)
            for each in figures:
                print("   ", each[2], file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
