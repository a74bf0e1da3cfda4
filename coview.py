"""coview on the command line: each command parses its arguments, calls one function and prints what it returns."""

from __future__ import annotations

import json as to_json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
import tyro
from tqdm import tqdm
from tyro.conf import Positional, subcommand

if TYPE_CHECKING:
    from models.packing import Recording
    from placement_env.candidates.candidates import Candidates
    from placement_env.objective import Objective, Score
    from placement_env.search.result import Result
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.datasets.random_recordings import RandomRecording
    from toolkit.objects import Detector
    from toolkit.sites.site import Site

OK, FOUND, BAD_INPUT, MISSING, INTERRUPTED = 0, 1, 2, 3, 130

Scheme = Literal["early", "late", "hybrid"]
Method = Literal[
    "exhaustive", "greedy", "lazy", "stochastic", "raced", "swap", "annealing", "cpsat", "nsga2", "cmaes", "ppo"
]  # fmt: skip
METHODS: dict[Method, tuple[str, str]] = {
    **{name: (f"search.{name}", "search") for name in get_args(Method)}, "lazy": ("search.greedy", "lazy"),
    "stochastic": ("search.greedy", "stochastic"), "raced": ("search.greedy", "raced"),
    "ppo": ("rl.training", "search"),
}  # fmt: skip


def simulate(
    site: Positional[str],
    /,
    *,
    out: Path,
    frames: int = 1000,
    seed: int = 0,
    workers: int | None = None,
    meshes: Path | None = None,
    held_out: bool = False,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Record a site: SUMO moves the traffic, rays are cast, HDF5 in the paper's layout is written.

    Killed at any moment and started again it goes on where it was, to the same bytes.

    Example: coview simulate tjunction --frames 1000 --seed 7 --out tjunction.hdf5

    Args:
        site: tjunction, roundabout, or a site file.
        out: HDF5 file to write.
        frames: How many frames.
        seed: Same seed, same machine: same bytes.
        workers: Processes; one per core when left out.
        meshes: Folder of your own meshes, anything Open3D reads.
        held_out: Of our own cars take those that no shipped detector was trained on, to test one.
        overwrite: Replace a file that holds another recording.
        json: Print the summary as JSON.
    """
    from toolkit.bodies.fleet import catalogue
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.sites.files import load_site

    place, started = load_site(site), perf_counter()
    with tqdm(total=frames, unit="frame", disable=json or None) as bar:
        new = simulate_dataset(
            place, frames=frames, seed=seed, out=out, workers=workers, bodies=catalogue(meshes, held_out),
            overwrite=overwrite, progress=_advance(bar),
        )  # fmt: skip
    seconds = perf_counter() - started
    summary = {"file": str(out), "site": place.name, "frames": frames, "frames_made_now": new, "seconds": seconds}
    text = f"{out}: {frames} frames at {place.name}, {new} of them made now, {new / seconds:.1f} a second"
    _print(summary, text, json)
    return OK


def evaluate(
    dataset: Positional[Path],
    /,
    *,
    detector: str = "cluster",
    schemes: tuple[Scheme, ...] = ("early", "late", "hybrid"),
    sensors: tuple[str, ...] = ("all",),
    iou: tuple[float, ...] = (0.7, 0.8, 0.9),
    metric: Literal["3d", "bev"] = "3d",
    protocol: Literal["exact", "published"] = "exact",
    label: Literal["vehicle", "cyclist", "pedestrian", "heavy"] = "vehicle",
    radius: float | None = None,
    frames: int | None = None,
    seed: int = 0,
    site: str | None = None,
    out: Path = Path("out/evaluation"),
    json: bool = False,
) -> int:
    """Score fusion schemes and sensor sets on a recording: the paper's first table, as text, JSON and PR curves.

    Example: coview evaluate tjunction.hdf5 --schemes early late --sensors 0,2,5 all --iou 0.7 0.8

    Args:
        dataset: Recording made by coview simulate, or one of the authors' files.
        detector: cluster; or a trained network: voxelnet for the site's own, a name, or a weights file.
        schemes: Which of early, late and hybrid fusion.
        sensors: Sensor sets, each a comma-separated list of numbers or names, or all.
        iou: IoU thresholds.
        metric: IoU of volumes or of footprints.
        protocol: exact, or the published code's own way of counting.
        label: Class to score.
        radius: Hybrid fusion shares points farther than this from their sensor (m); the paper's value when left out.
        frames: Only the first so many frames.
        seed: Of the sensors' noise.
        site: Name or file; needed for foreign recordings that show no built-in site.
        out: Folder for table.json and the PR curves.
        json: Print the rows as JSON.
    """
    from toolkit.detection.evaluation import evaluate_dataset, format_table, save_evaluation

    with _recording(dataset, site) as recording:
        total = _count(recording, frames)
        with tqdm(total=total, unit="frame", disable=json or None) as bar:
            rows = evaluate_dataset(
                recording, _detector(detector, recording), schemes=schemes, iou_thresholds=iou, frames=total,
                sensor_sets=[_sensor_set(chosen) for chosen in sensors], noise_seed=seed, radius=radius,
                protocol=protocol, metric=metric, label=label, progress=_advance(bar),
            )  # fmt: skip
    save_evaluation(rows, out)
    table = f"{format_table(rows)}\nwritten to {out}/table.json, PR curves beside it"
    _print({"rows": [row.as_dict() for row in rows]}, table, json)
    return OK


def survey(
    dataset: Positional[Path],
    /,
    *,
    sensors: tuple[str, ...] = ("all",),
    frames: int | None = None,
    seed: int = 0,
    site: str | None = None,
    json: bool = False,
) -> int:
    """Count what a recording holds: objects per frame, kbit of early fusion, vehicles without a point.

    Example: coview survey tjunction.hdf5 --sensors 4 3,4 0,2,5 all

    Args:
        dataset: Recording.
        sensors: Sensor sets, as in coview evaluate.
        frames: Only the first so many frames.
        seed: Of the sensors' noise.
        site: As in coview evaluate.
        json: Print as JSON.
    """
    from toolkit.detection.survey import survey as count
    from toolkit.points import select_sensors

    with _recording(dataset, site) as recording:
        total = _count(recording, frames)
        sets = [select_sensors(recording.sensors, _sensor_set(chosen)) for chosen in sensors]
        with tqdm(total=total, unit="frame", disable=json or None) as bar:
            figures = count(recording, frames=total, noise_seed=seed, progress=_advance(bar)).as_dict(sets)
    objects = "  ".join(f"{name} {number:.2f}" for name, number in figures["objects_per_frame"].items())
    lines = [f"objects per frame in the area: {objects}", f"early fusion: {figures['kbit_per_sensor']:.0f} kbit/sensor"]
    lines += [f"vehicles without a point from {chosen}: {share:.1%}" for chosen, share in figures["unseen"].items()]
    _print(figures, "\n".join(lines), json)
    return OK


def fuse(
    clouds: Positional[tuple[Path, ...]] = (),
    /,
    *,
    poses: tuple[Path, ...] = (),
    inverted: bool = False,
    area: tuple[float, float, float, float] | None = None,
    height: float = 4.0,
    floor: float = 0.0,
    out: Path | None = None,
    argoverse: Path | None = None,
    json: bool = False,
) -> int:
    """Fuse cloud files in the frame of their poses; or take an Argoverse 2 log apart, fuse it back and check it.

    Example: coview fuse north.ply south.pcd --poses poses.json --area -40 -20 40 20 --out junction.ply
    Example: coview fuse --argoverse my-log

    Args:
        clouds: ply, pcd, xyz, txt, csv, npy, npz, KITTI bin, feather.
        poses: One file with all poses, or one file for each cloud.
        inverted: The files give world to sensor (extrinsics) instead of sensor to world.
        area: Crop to xmin ymin xmax ymax (m).
        height: Crop above (m), with --area.
        floor: Crop below (m), with --area.
        out: Where to write the fused cloud (ply or pcd).
        argoverse: A log with two lidars; points per labelled cuboid are printed beside the recording's own counts.
        json: Print as JSON.
    """
    from toolkit.clouds import crop, positions, save
    from toolkit.datasets.cloud_files import fuse_files, poses_of

    if argoverse is not None:
        return _check_argoverse(argoverse, json)
    if not clouds or not poses:
        raise ValueError("give cloud files and --poses, or --argoverse LOG")
    cloud = fuse_files(clouds, poses_of(clouds, poses, inverted=inverted))
    if area is not None:
        cloud = crop(cloud, area, height, floor=floor)
    if out is not None:
        save(cloud, out)
    points = positions(cloud)
    summary = {"files": len(clouds), "points": len(points), "out": out and str(out)}
    _print(summary, f"{len(points)} points of {len(clouds)} files{f', written to {out}' if out else ''}", json)
    return OK


def doctor(dataset: Positional[Path], /, *, site: str | None = None, json: bool = False) -> int:
    """Check a recording for the classic mistakes and say which are suspected and why. Exit code 1 if any is.

    Example: coview doctor my-recording.hdf5

    Args:
        dataset: Any recording in the published layout.
        site: As in coview evaluate.
        json: Print as JSON.
    """
    from toolkit.datasets.doctor.diagnosis import diagnose
    from toolkit.sites.files import load_site

    findings = diagnose(dataset, load_site(site) if site else None)
    _print([asdict(finding) for finding in findings], "\n".join(map(str, findings)) or "nothing suspected", json)
    return FOUND if findings else OK


@dataclass(frozen=True)
class ImportMap:
    """Make a site from a real map: roads and footways through SUMO's netconvert, buildings from OpenStreetMap.

    Example: coview site import --opendrive Town01.xodr --centre 104 -196 --size 80 40 --out my-junction.json

    Attributes:
        centre: Of the detection area: metres of an OpenDRIVE map, longitude and latitude of an OpenStreetMap file.
        size: Of the detection area along x and y (m).
        out: Site file to write.
        opendrive: OpenDRIVE file (.xodr).
        osm: OpenStreetMap file (.osm, .osm.gz).
        heading_deg: Direction of the area's x axis, counter-clockwise from the map's east.
        lefthand: Traffic keeps left (OpenStreetMap only).
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    out: Path
    opendrive: Path | None = None
    osm: Path | None = None
    heading_deg: float = 0.0
    lefthand: bool = False

    def __call__(self) -> int:
        """Import, save, say what came of it."""
        from toolkit.sites.files import save_site
        from toolkit.sites.maps import import_opendrive, import_osm

        place: dict[str, Any] = {
            "centre": self.centre, "size": self.size, "heading": float(np.deg2rad(self.heading_deg))
        }  # fmt: skip
        if (self.opendrive is None) == (self.osm is None):
            raise ValueError("give one map: --opendrive FILE or --osm FILE")
        if self.opendrive is not None and self.lefthand:
            raise ValueError("--lefthand is for --osm: an OpenDRIVE map says itself which side traffic keeps to")
        if self.opendrive is not None:
            imported = import_opendrive(self.opendrive, **place)
        else:
            imported = import_osm(self.osm, **place, lefthand=self.lefthand)  # type: ignore[arg-type]
        save_site(imported, self.out)
        print(f"{imported}\nwritten to {self.out}")
        return OK


@dataclass(frozen=True)
class RandomSite:
    """Draw a junction that nobody made by hand.

    Example: coview site random --seed 3 --out random-3.json

    Attributes:
        out: Site file to write.
        seed: Which one.
    """

    out: Path
    seed: int = 0

    def __call__(self) -> int:
        """Draw, save, say what came of it."""
        from toolkit.sites.files import save_site
        from toolkit.sites.random import random_site

        drawn = random_site(self.seed)
        save_site(drawn, self.out)
        print(f"{drawn}\nwritten to {self.out}")
        return OK


@dataclass(frozen=True)
class ShowSite:
    """Say what a site holds, and draw it from above when given --out FILE.png.

    Example: coview site show roundabout --out roundabout.png

    Attributes:
        site: tjunction, roundabout, or a site file.
        out: Picture to write.
    """

    site: Positional[str]
    out: Path | None = None

    def __call__(self) -> int:
        """Load (and so validate), say what is there, draw."""
        from toolkit.plots import draw_site
        from toolkit.sites.files import load_site

        shown = load_site(self.site)
        print(shown)
        if self.out is not None:
            draw_site(shown, self.out)
        return OK


def site(
    command: Annotated[ImportMap, subcommand("import")]
    | Annotated[RandomSite, subcommand("random")]
    | Annotated[ShowSite, subcommand("show")],
) -> int:
    """Make, draw and check sites."""
    return command()


def demo(*, out: Path = Path("out/demo"), frames: int = 100, seed: int = 1, detector: str = "voxelnet") -> int:
    """What six sensors at a T-junction detect by early, late and hybrid fusion: table, pictures, PR curves.

    Args:
        out: Folder for the recording, the table and the pictures.
        frames: How many frames to record and score.
        seed: Of the traffic.
        detector: As in coview evaluate.
    """
    from toolkit.datasets.dataset import noisy
    from toolkit.detection.fusion import early
    from toolkit.plots import draw_frame
    from toolkit.points import frame_points

    out.mkdir(parents=True, exist_ok=True)
    recording_file = out / "tjunction.hdf5"
    simulate("tjunction", out=recording_file, frames=frames, seed=seed)
    evaluate(recording_file, detector=detector, out=out)
    with _recording(recording_file, None) as recording:
        detect, place = _detector(detector, recording), recording.site
        frame = noisy(max(recording, key=lambda frame: len(frame.objects)), seed)
        draw_frame(
            place, out / "birds_eye.png", clouds=frame_points(frame, area=place), truth=frame.objects,
            detections=early(frame, detect, site=place).detections,
            title=f"{place.name}, frame {frame.index}: early fusion of {len(frame.sensors)} sensors",
        )  # fmt: skip
    print(f"pictures in {out}: birds_eye.png, pr_0.7.png")
    return OK


def pack(
    datasets: Positional[tuple[Path, ...]] = (),
    /,
    *,
    out: Path,
    random_sites: int = 0,
    frames: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    site: str | None = None,
    json: bool = False,
) -> int:
    """Pack recordings for training: one small file that needs no Open3D and no SUMO to be read.

    Example: coview pack tjunction.hdf5 --out tjunction.packed
    Example: coview pack --random-sites 200 --frames 20 --seed 1 --out general.packed

    Args:
        datasets: Recordings; their sites may differ.
        out: Packed file to write.
        random_sites: Draw so many junctions with sensors and traffic instead, and record each.
        frames: Only the first so many of each recording; of each random site, 20 when left out.
        seed: Of the random sites.
        workers: Processes for random sites; one per core when left out.
        site: As in coview evaluate.
        json: Print the summary as JSON.
    """
    from models.packing import pack as write

    if frames is not None and frames < 1:
        raise ValueError(f"--frames must be at least 1, got {frames}: leave it out for all")
    if bool(datasets) == bool(random_sites):
        raise ValueError("give recordings, or --random-sites N")
    if random_sites:
        from toolkit.datasets.random_recordings import random_recordings

        with tqdm(total=random_sites, unit="site", disable=json or None) as bar:
            drawn = random_recordings(
                random_sites, frames or 20, seed, _packed, workers=workers, progress=_advance(bar)
            )  # fmt: skip
            total = write(drawn, out)
    else:
        recordings = [_recording(path, site) for path in datasets]
        count = sum(min(len(recording), frames or len(recording)) for recording in recordings)
        with tqdm(total=count, unit="frame", disable=json or None) as bar:
            total = write((_packed(recording, frames) for recording in recordings), out, progress=_advance(bar))
    megabytes = out.stat().st_size / 1e6
    _print({"file": str(out), "frames": total, "mb": megabytes}, f"{out}: {total} frames, {megabytes:.0f} MB", json)
    return OK


def train(
    site: Positional[str],
    /,
    *,
    data: Path,
    out: Path,
    start: str | None = None,
    preset: Literal["fast", "paper", "general"] | None = None,
    size: Literal["light", "published"] = "light",
    voxel: float | None = None,
    epochs: float | None = None,
    batch: int | None = None,
    learning_rate: float | None = None,
    seed: int = 0,
    validate: Path | None = None,
    validate_frames: int | None = 200,
    device: str | None = None,
    threads: int | None = None,
    workers: int = 0,
    json: bool = False,
) -> int:
    """Train VoxelNet on a packed file. Killed at any moment and started again it goes on, to the same weights.

    Example: coview train tjunction --preset fast --data tjunction.packed --out runs/tjunction --validate test.packed

    Args:
        site: Gives the area: tjunction, roundabout, a site file; or general, for a network that works anywhere.
        data: Made by coview pack.
        out: Folder for checkpoint, log, curves and weights.safetensors.
        start: Weights to go on from, a shipped name (general, to fit it to your junction) or a file, instead of random.
        preset: fast, or general for general, when left out; paper: as published.
        size: The light network, or one as wide as the published.
        voxel: Length and width of a voxel (m); 0.2 when left out (the paper has 0.4 at the roundabout).
        epochs: Passes over the data; the preset's when left out.
        batch: Frames per step; the preset's when left out.
        learning_rate: The highest; the preset's when left out.
        seed: Of weights, order, noise and augmentation.
        validate: Packed file to measure AP on after each epoch.
        validate_frames: Only its first so many.
        device: cpu or cuda; cuda where there is one when left out.
        threads: Of PyTorch; with other programs on the machine, fewer are faster.
        workers: Processes that prepare examples.
        json: Print the summary as JSON.
    """
    import torch

    from models.detector import moved, weights_file
    from models.train import ANYWHERE, LOG, PRESETS, commit, config_for
    from models.train import train as run
    from models.training_log import curves
    from models.validation import validation
    from models.weights import Header, load_weights, save_weights
    from toolkit.plots import draw_training
    from toolkit.sites.files import load_site

    if threads:
        torch.set_num_threads(threads)
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    preset = preset or ("general" if site == "general" else "fast")
    place = None if site == "general" else load_site(site)
    area = ANYWHERE if place is None else tuple(place.area.tolist())
    wanted = {"epochs": epochs, "batch": batch, "learning_rate": learning_rate}
    settings = replace(PRESETS[preset], seed=seed, **{name: value for name, value in wanted.items() if value})
    config = config_for(area, preset, size)
    if voxel is not None:
        config = replace(config, voxel_size=(voxel, voxel, config.voxel_size[2]))
    measure = validation(validate, count=validate_frames, device=device) if validate else None
    measured: dict[str, float] = {}

    def report(step: int, total: int, figures: dict[str, float]) -> None:
        bar.total = total
        bar.update(step - bar.n)
        if "AP@0.7" in figures:
            measured.update(figures)
            bar.write("  ".join(f"{name} {value:.4f}" for name, value in figures.items()))
        else:
            bar.set_postfix({name: f"{value:.3f}" for name, value in figures.items()}, refresh=False)

    with tqdm(unit="step", disable=json, smoothing=0.05) as bar:
        network = run(
            data, config, settings, out, start=load_weights(weights_file(start))[0] if start else None,
            device=device, workers=workers, validate=measure, progress=report,
        )  # fmt: skip
    save_weights(
        out / "weights.safetensors",
        moved(network, area, "general"),
        Header("general" if place is None else place.name, seed, commit(), measured),
    )
    draw_training(curves(out / LOG), out)
    _print(
        {"weights": str(out / "weights.safetensors"), "ap": measured},
        f"{out}: weights.safetensors, {LOG}, losses.png{', ap.png' if validate else ''}", json,
    )  # fmt: skip
    return OK


def search(
    site: Positional[str],
    /,
    *,
    method: Method = "greedy",
    budget: int = 4,
    scheme: Scheme = "early",
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate",
    verify: Literal["detector"] | None = None,
    candidates: str = "pool",
    frames: int = 200,
    iou: float = 0.7,
    comm: float = 0.0,
    price: float = 0.0,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    cache: Path | None = Path("out/cache"),
    workers: int = 1,
    ray: str | None = None,
    json: bool = False,
) -> int:
    """Search the sensors to build: which poles, headings and tilts, at most a budget of them, one per pole.

    Example: coview search tjunction --method greedy --budget 4 --scheme early --fidelity surrogate --verify detector

    Args:
        site: tjunction, roundabout, or a site file.
        method: How to search; cpsat proves how much more could be covered, exhaustive needs 16 candidates or fewer,
            raced drops weak candidates after few frames and needs fidelity detector, cmaes turns and lifts the sensors
            that greedy found, ppo learns a policy first.
        budget: Most sensors.
        scheme: How their measurements are fused.
        fidelity: How a set is scored while searching; table knows the built-in sites' own sensors only.
        verify: Score what was found, and its best neighbours, with the detector.
        candidates: pool, paper for the site's own sensors, or a GeoJSON file of poles.
        frames: Of simulated traffic.
        iou: At which a detection counts.
        comm: AP that a kbit per sensor and frame costs.
        price: AP that one ordinary mount costs.
        seed: Of traffic and search.
        seconds: Stop after so many.
        evaluations: Stop after so many sets.
        cache: Folder where what was rendered and detected is kept for the next search, None for nowhere.
        workers: Processes that render and detect.
        ray: Address of a Ray cluster that does it instead; local for this machine.
        json: Print as JSON.
    """
    from importlib import import_module

    from placement_env.objective import Objective, Weights
    from toolkit.sites.files import load_site

    place = load_site(site)
    settings: dict[str, Any] = {
        "candidates": _candidates(place, candidates), "iou": iou, "seed": seed, "cache": cache, "workers": workers,
        "ray": ray,
    }  # fmt: skip
    objective = Objective(place, frames, scheme, fidelity, Weights(comm, price), **settings)
    module, function = METHODS[method]
    run = getattr(import_module(f"placement_env.{module}"), function)
    found = run(objective, budget, seed=seed, seconds=seconds, evaluations=evaluations)
    names = _chosen(objective, found)
    summary = {**asdict(found.best), "sensors": names, "certificate": asdict(found.certificate),
               "evaluations": found.evaluations, "seconds": found.seconds}  # fmt: skip
    lines = [str(found), found.certificate.note, *(f"  {name}" for name in names), _figures(found.best)]
    lines += [f"front: {_figures(score)} {score.subset}" for score in found.front]
    if verify is not None and names:
        dear = Objective(place, frames, scheme, verify, Weights(comm, price), **settings)
        best, told = _verified(objective, dear, found)
        summary["verified"] = {**asdict(best), "sensors": [dear.names[c] for c in best.subset]}
        lines += [told, *(f"  {dear.names[c]}" for c in best.subset), _figures(best)]
    _print(summary, "\n".join(line for line in lines if line), json)
    return OK


def _chosen(objective: Objective, found: Result) -> list[str]:
    """Names of the sensors found, with where they were moved to, if they were."""
    from placement_env.candidates.aim import aims

    names = [objective.names[c] for c in found.best.subset]
    if not found.sensors:
        return names
    degrees = np.rad2deg(np.stack(aims(found.sensors), axis=1))
    where = [(*sensor.position, *aim) for sensor, aim in zip(found.sensors, degrees, strict=True)]
    told = "{} moved to x {:.2f} y {:.2f} z {:.2f} m, heading {:.1f} tilt {:.1f} degrees"
    return [told.format(name, *numbers) for name, numbers in zip(names, where, strict=True)]


def _verified(cheap: Objective, dear: Objective, found: Result) -> tuple[Score, str]:
    """The best set by a dear objective of what a search on a cheap one found and its neighbours, and how it was chosen.
    Sensors that were moved have no neighbours."""
    from placement_env.search.verification import rescored, verified

    if found.sensors:
        return rescored(dear, found), f"by the {dear.fidelity}, moved:"
    ranking = verified(cheap, dear, np.array(found.best.subset))
    return dear.score(np.flatnonzero(ranking.sets[0])), f"best by the {dear.fidelity} of {len(ranking.sets)} sets:"


def table(
    dataset: Positional[Path],
    /,
    *,
    out: Path,
    detector: str = "voxelnet",
    frames: int | None = None,
    site: str | None = None,
    workers: int = 1,
    ray: str | None = None,
    json: bool = False,
) -> int:
    """Score every set of a recording's sensors, in every scheme, with a detector; killed and started again it goes on.

    Example: coview table tj_test.hdf5 --frames 200 --workers 2 --out tjunction.npz

    Args:
        dataset: Recording of at most 16 sensors.
        out: Table to write (.npz); placement_env loads it by its path.
        detector: As in coview evaluate.
        frames: Only the first so many frames.
        site: As in coview evaluate.
        workers: Processes.
        ray: Address of a Ray cluster instead.
        json: Print the best sets as JSON.
    """
    from models.train import commit
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.table import best_sets, make_table

    with _recording(dataset, site) as recording, tqdm(unit="frame", disable=json or None) as bar:

        def report(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        made = make_table(
            Renders.of(recording), _detector(detector, recording), out,
            frames=_count(recording, frames), commit=commit(), workers=workers, ray=ray, progress=report,
        )  # fmt: skip
    best = {scheme: best_sets(made, scheme) for scheme in get_args(Scheme)}
    lines = [
        f"{scheme:<7} {size} sensors  " + "  ".join(f"{','.join(map(str, s))}: {ap:.4f}" for s, ap in sets)
        for scheme, sizes in best.items()
        for size, sets in sizes.items()
    ]
    _print(best, "\n".join(lines), json)
    return OK


COMMANDS: dict[str, Callable[..., int]] = {
    "demo": demo, "simulate": simulate, "evaluate": evaluate, "survey": survey, "fuse": fuse, "doctor": doctor,
    "site": site, "pack": pack, "train": train, "search": search, "table": table,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Fuse, detect and measure what several sensors see of a junction.

    Exit codes: 0 done, 1 the doctor suspects something, 2 bad input, 3 a package is missing, 130 stopped.
    """
    warnings.showwarning = lambda message, *_, **__: print(f"coview: note: {message}", file=sys.stderr)
    try:
        code = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="coview",
            description=main.__doc__,
            args=arguments,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
    except ImportError as error:
        code = _fail(str(error), MISSING)
    except OSError as error:
        code = _fail(_explained(error), BAD_INPUT)
    except (ValueError, IndexError, RuntimeError) as error:
        code = _fail(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        code = _fail("stopped; the same command goes on where it was", INTERRUPTED)
    sys.exit(code)


def _fail(message: str, code: int) -> int:
    print(f"coview: {' '.join(message.split())}", file=sys.stderr)
    return code


def _explained(error: OSError) -> str:
    """What the system refused to do with which file, without its number."""
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"cannot use {error.filename}: {error.strerror}; give another path, or make this one readable and writable"


def _print(result: Any, text: str, as_json: bool) -> None:
    print(to_json.dumps(_finite(result), allow_nan=False) if as_json else text)


def _finite(value: Any) -> Any:
    """null for the numbers that JSON has not: an infinite bound, the AP of nothing to find."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _advance(bar: Any) -> Callable[[int], None]:
    """A callback that moves a progress bar to an absolute count."""
    return lambda done: bar.update(done - bar.n) and None


def _recording(dataset: Path, site: str | None) -> CoopDataset:
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.sites.files import load_site

    return CoopDataset(dataset, load_site(site) if site else None)


def _packed(recording: CoopDataset | RandomRecording, frames: int | None = None) -> Recording:
    """A recording as what `models.packing.pack` writes."""
    from models.packing import recording as packed
    from toolkit.datasets.dataset import CoopDataset

    if isinstance(recording, CoopDataset):
        return packed(recording, recording.site.area, recording.site.height, count=frames)
    return packed(recording.frames, recording.site.area, recording.site.height, empty=recording.empty)


def _count(recording: CoopDataset, frames: int | None) -> int:
    """How many frames of a recording are wanted."""
    if frames is not None and frames < 1:
        raise ValueError(f"--frames must be at least 1, got {frames}: leave it out for all")
    return len(recording) if frames is None else min(frames, len(recording))


def _sensor_set(text: str) -> list[int | str] | None:
    """`all`, or numbers and names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if len(set(names)) < len(names):
        raise ValueError(f"each sensor may be named once in a set, got {text}: leave the repetition out")
    return None if names == ["all"] else [int(name) if name.isdecimal() else name for name in names]


def _detector(name: str, recording: CoopDataset) -> Detector:
    """The classical detector, or a trained one: for the recording's own site (voxelnet), a name, a weights file."""
    if name == "cluster":
        return _cluster(recording)
    from models.detector import SHIPPED, load_detector

    place = recording.site
    if name == "voxelnet":
        name = place.name if Path(SHIPPED, f"{place.name}.safetensors").exists() else "general"
    return load_detector(name, area=place.area)


def _cluster(recording: CoopDataset) -> Detector:
    """The classical detector, having seen the recording's site empty."""
    from toolkit.detection.cluster import ClusterDetector
    from toolkit.frame import empty_scene
    from toolkit.points import frame_points

    empty, rng = empty_scene(recording), np.random.default_rng(0)
    return ClusterDetector.learn(
        points for _ in range(4) for points in frame_points(empty, area=recording.site, rng=rng)
    )


def _candidates(site: Site, which: str) -> Candidates:
    """The site's pool, its own sensors (paper), or the pool of the poles in a GeoJSON file."""
    from placement_env.candidates.poles import load_keep_out, load_poles
    from placement_env.candidates.pool import paper_candidates, pool

    if which in ("pool", "paper"):
        return pool(site) if which == "pool" else paper_candidates(site)
    return pool(site, mounts=load_poles(which, site), keep_out=load_keep_out(which, site))


def _figures(score: Score) -> str:
    return (
        f"AP {score.ap:.4f}, recall {score.recall:.4f}, {score.kbit_per_sensor:.1f} kbit per sensor, "
        f"{score.kbit:.1f} kbit, price {score.price:g} ({score.fidelity})"
    )


def _check_argoverse(log: Path, as_json: bool) -> int:
    from toolkit.datasets.argoverse import count_labels, sweep_times

    rows = []
    for time in sweep_times(log):
        labels, counted = count_labels(log, time)
        rows += [
            {"sweep": time, "category": category, "points": int(ours), "recorded": int(theirs)}
            for category, ours, theirs in zip(labels.categories, counted, labels.interior_points, strict=True)
        ]
    lines = [f"{row['sweep']}  {row['category']:<24} {row['points']:>6} {row['recorded']:>6}" for row in rows]
    agree = sum(row["points"] == row["recorded"] for row in rows)
    _print({"rows": rows}, "\n".join([*lines, f"{agree} of {len(rows)} cuboids agree"]), as_json)
    return OK


if __name__ == "__main__":
    main()
