"""Training on a bare machine, as `coview train` without pictures: packed recordings in, a weights
file out.

python -m models.train tjunction --data train.packed --validate test.packed --out runs/tjunction
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from models.detector import relocate, weights_file
from models.network.voxelnet import VoxelNet
from models.training import loop
from models.training.loop import (
    ANYWHERE,
    CHECKPOINT,
    LOG,
    LOG_STEPS,
    PRESETS,
    Preset,
    Progress,
    train,
)
from models.training.options import TrainingOptions, parse_arguments
from models.training.packed import PackedFrames
from models.training.second_stage import compute_recording_ap, fit_calibration, train_faces, widen
from models.weight_files import WeightsHeader, load_weights, save_weights
from toolkit.runtime.output_checks import check_output
from toolkit.runtime.resumable import ShardFolder
from toolkit.runtime.text_tables import escape
from toolkit.sites.files import load_site

WEIGHTS = "weights.safetensors"


def run(
    site: str | None, options: TrainingOptions, *, progress: Progress | None = None
) -> tuple[Path, dict[str, float]]:
    """Train or resume with the options of `coview train`; return the weights file and the last
    validation figures.

    site: a built-in one, a site file, "general", or None for the area that the data shares. Raises
    the errors of `train`, and FileExistsError if the folder holds other weights, or another run
    trains there.
    """
    preset = options.preset or ("general" if site == "general" else "fast")
    device = options.device or ("cuda" if torch.cuda.is_available() else "cpu")
    site_map = None if site in (None, "general") else load_site(site)
    if site_map:
        area = tuple(site_map.area.tolist())
    else:
        area = loop.choose_area("general" if site else preset, options.data)
    settings = _change_preset(PRESETS[preset], options)
    start_network = load_weights(weights_file(options.start))[0] if options.start else None
    stages = second_stages(options, start_network)
    config = loop.make_config(area, preset, options.size, stages.classes)
    if options.voxel is not None:
        config = replace(config, voxel_size=(options.voxel, options.voxel, config.voxel_size[2]))
    weights = options.out / WEIGHTS
    check_output(
        weights, inputs=[weights_file(options.start)] if options.start else [], overwrite=True
    )
    with ShardFolder(options.out, {}).lock():
        if options.overwrite:
            for name in (CHECKPOINT, LOG):
                (options.out / name).unlink(missing_ok=True)
        elif not (options.out / CHECKPOINT).exists():
            check_output(weights)
        start = None if start_network is None else widen(start_network, config)
        validation = PackedFrames(options.validate) if options.validate else None
        count = options.validate_frames
        if options.threads:
            torch.set_num_threads(options.threads)
        figures: dict[str, float] = {}

        def measure(network: VoxelNet) -> dict[str, float]:
            assert validation is not None
            figures.update(compute_recording_ap(network, validation, count=count, device=device))
            return dict(figures)

        machine = loop.Machine(
            device,
            options.bfloat16 or device == "cuda",
            options.workers,
            options.checkpoint_s,
            options.seconds,
        )
        watch = None if validation is None else measure
        fit = partial(
            train, options.data, config, settings, options.out, start=start, machine=machine
        )
        network = fit(validate=watch, progress=progress)
        if stages.faces:
            data = PackedFrames(options.data)
            network = train_faces(network, data, stages.faces, seed=options.seed)
        if stages.calibrate and validation is not None:
            network = fit_calibration(network, validation, count=count)
        if validation is not None and (stages.faces or stages.calibrate):
            measure(network)
        if site_map:
            trained_for = site_map.name
        else:
            trained_for = "general" if area == ANYWHERE else options.data.stem
        save_weights(
            weights,
            relocate(network, area, "general"),
            WeightsHeader(trained_for, options.seed, commit(), figures),
        )
    return weights, figures


def _change_preset(preset: Preset, options: TrainingOptions) -> Preset:
    """Preset with the values that the options give."""
    named_options = {name: getattr(options, name) for name in ("epochs", "batch", "learning_rate")}
    changes = {name: value for name, value in named_options.items() if value}
    examples = replace(preset.examples, windows=options.windows)
    return replace(preset, seed=options.seed, examples=examples, **changes)


class SecondStages(NamedTuple):
    """Classes of a network and its second stages.

    Attributes:
        classes: Classes to detect.
        faces: Classes with measured faces.
        calibrate: Whether scores are calibrated.
    """

    classes: tuple[str, ...]
    faces: tuple[str, ...]
    calibrate: bool


def second_stages(options: TrainingOptions, start: VoxelNet | None) -> SecondStages:
    """Classes and second stages of a training, by default as in `start`.

    Raises ValueError for faces of other classes."""
    classes = options.classes
    faces = options.faces
    if classes is None:
        classes = ("vehicle",) if start is None else start.config.labels
    if faces is None:
        faces = ()
        if start is not None:
            faces = tuple(name for name in start.config.faces if name in classes)
    calibrate = options.calibrate or (start is not None and bool(start.config.calibration))
    if not set(faces) <= set(classes):
        raise ValueError(
            f"--faces must be among --classes {' '.join(classes)}, got {' '.join(faces)}"
        )
    return SecondStages(classes, faces, calibrate)


def commit() -> str:
    """Commit of this checkout, "unknown" outside one."""
    here = Path(__file__).parent
    try:
        process = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return "unknown"
    return process.stdout.strip() or "unknown"


def main(arguments: Sequence[str] | None = None) -> None:
    """Train from the command line of a bare machine."""
    site, options = parse_arguments(arguments)
    started = time.monotonic()

    def report(step: int, total: int, figures: dict[str, float]) -> None:
        if step % LOG_STEPS == 0 or step == total or "AP@0.7" in figures:
            text = "  ".join(f"{name} {value:.4f}" for name, value in figures.items())
            print(f"{time.monotonic() - started:8.0f} s  step {step}/{total}  {text}", flush=True)

    try:
        weights, _ = run(site, options, progress=report)
    except (ValueError, OSError) as error:
        sys.exit(f"models.train: {escape(' '.join(str(error).split()))}")
    print(f"written to {escape(weights)}")


if __name__ == "__main__":
    main()
