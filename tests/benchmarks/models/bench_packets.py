"""AP that foreground loses because every message must fit one packet.

    python tests/benchmarks/models/bench_packets.py [--frames 40] [--seeds 61 62 63 64 65]
        [--streets tjunction roundabout roundabout-dense] [--folder out/packets]

For each street and seed a recording of independent frames is simulated, and kept in the folder. The
sensors know their empty scenes from 128 frames of another day. The site's network detects in all
raw points (`early`), in foreground in steps of 2 cm, whatever its bytes, and in foreground that
fits one packet, with real messages. Losses of AP are against raw points, mean over the seeds with
the standard error of that mean. Dense traffic has up to 90 objects in place of 30.
"""

import argparse
from pathlib import Path

import numpy as np

from coview.detectors import open_detector
from tests.benchmarks.figures import record
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.calibration.recording_scenes import Scenes
from toolkit.calibration.scene_files import load_empty_scenes, save_empty_scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import Reads
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.evaluation_result import Evaluation
from toolkit.detection.link.foreground import Foreground
from toolkit.runtime.run import Run
from toolkit.traffic.snapshots import Mix

DENSE_OBJECTS = 90
STREETS = {
    "tjunction": ("tjunction", Mix()),
    "tjunction-dense": ("tjunction", Mix(most=DENSE_OBJECTS)),
    "roundabout": ("roundabout", Mix()),
    "roundabout-dense": ("roundabout", Mix(most=DENSE_OBJECTS)),
}
TITLES = {
    "tjunction": "T-junction",
    "tjunction-dense": "T-junction, dense",
    "roundabout": "roundabout",
    "roundabout-dense": "roundabout, dense",
}
IOUS = (0.7, 0.8, 0.9)
MAX_LOSSES = (0.005, 0.008, 0.03)  # of AP, at these thresholds
MIN_SHARE = 0.997  # of messages in one packet
RATE_HZ = 10.0
OTHER_DAY_FRAMES, OTHER_DAY_SEED = 128, 1419
EARLY = "early"
ANY_BYTES = "foreground, 2 cm"
ONE_PACKET = "foreground"
SCHEMES = (EARLY, Foreground(name=ANY_BYTES, max_step=0.02), Foreground())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--seeds", type=int, nargs="+", default=[61, 62, 63, 64, 65])
    parser.add_argument("--streets", nargs="+", default=["tjunction", "roundabout"])
    parser.add_argument("--folder", type=Path, default=Path("out/packets"))
    options = parser.parse_args()
    for street in options.streets:
        evaluations = [
            evaluate_street(options.folder, street, seed, options.frames) for seed in options.seeds
        ]
        print_street(street, evaluations, options.frames)


def load_recording(folder: Path, site: str, mix: Mix, seed: int, frames: int) -> CoopDataset:
    """Return a recording, simulated if the folder lacks it."""
    path = folder / f"{site}-{mix.most}-{seed}-{frames}.hdf5"
    if not path.exists():
        simulate_dataset(site, path, run=Run(frames=frames, seed=seed), mix=mix)
    return CoopDataset(path)


def load_scenes(folder: Path, site: str) -> tuple[EmptyScene, ...]:
    """Return the empty scenes of a site's sensors, learnt on another day."""
    path = folder / f"{site}.npz"
    if not path.exists():
        recording = load_recording(folder, site, Mix(), OTHER_DAY_SEED, OTHER_DAY_FRAMES)
        save_empty_scenes(path, learn_empty_scenes(recording))
    return load_empty_scenes(path)


def evaluate_street(folder: Path, street: str, seed: int, frames: int) -> Evaluation:
    """Score vehicles in one recording by all schemes."""
    site, mix = STREETS[street]
    recording = load_recording(folder, site, mix, seed, frames)
    scenes = Scenes(recording, load_scenes(folder, site))
    comparison = Comparison(SCHEMES, classes=("vehicle",), iou_thresholds=IOUS, rate=RATE_HZ)
    return evaluate_recording(
        recording,
        open_detector(None, recording, scenes=scenes),
        comparison,
        reads=Reads(noise_seed=seed),
        scenes=scenes,
    )


def print_street(street: str, evaluations: list[Evaluation], frames: int) -> None:
    """Print AP and losses of a street, and record its row of the documentation."""
    ap = {}
    for scheme in (EARLY, ANY_BYTES, ONE_PACKET):
        rows = [[row.ap for row in result if row.scheme == scheme] for result in evaluations]
        ap[scheme] = np.array(rows)  # axes: seed, threshold
        print(f"{street}, {scheme}: AP {join_figures(ap[scheme].mean(axis=0))}")
    truths = sum(next(row.truths for row in result) for result in evaluations)
    print(f"  {len(evaluations)} x {frames} frames, {truths} vehicles")
    cells = []
    for scheme in (ANY_BYTES, ONE_PACKET):
        losses = ap[EARLY] - ap[scheme]
        mean = losses.mean(axis=0)
        error = losses.std(axis=0, ddof=1) / np.sqrt(len(losses))
        missed = "  MISSED" if (mean > MAX_LOSSES).any() and scheme == ONE_PACKET else ""
        print(f"  lost by {scheme}: {join_figures(mean)} ± {join_figures(error)}{missed}")
        cells.append(f"{join_figures(mean)} ± {join_figures(error)}")
    loads = [load.load for result in evaluations for load in result.loads]
    shares = []
    for row, scheme in enumerate((EARLY, ANY_BYTES, ONE_PACKET)):
        scheme_loads = loads[row :: len(SCHEMES)]
        share = float(np.mean([load.one_packet for load in scheme_loads]))
        packets_s = float(np.mean([load.packets_per_s for load in scheme_loads]))
        mbit = float(np.mean([load.mbit_per_s for load in scheme_loads]))
        airtime = float(np.mean([load.airtime_ms_per_s for load in scheme_loads]))
        print(
            f"  {scheme}: {100 * share:.2f} % in one packet, {packets_s:.1f} packets/s, "
            f"{mbit:.3f} Mbit/s, airtime {airtime:.1f} ms/s"
        )
        shares.append(share)
    if shares[-1] < MIN_SHARE:
        print(f"  MISSED: {100 * shares[-1]:.2f} % in one packet")
    cells += [f"{100 * share:.1f} %" for share in shares[1:]]
    record("one-packet", TITLES[street], cells, network="`site`")


def join_figures(values: np.ndarray) -> str:
    """Join figures at the thresholds.

    >>> join_figures(np.array([0.5, -0.25]))
    '0.5000/-0.2500'
    """
    return "/".join(f"{value:.4f}" for value in values)


if __name__ == "__main__":
    main()
