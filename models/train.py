"""Training from the command line: packed recordings in, a weights file out.

    python -m models.train tjunction --data train.packed --validate test.packed --out runs/tjunction

The same as `coview train`, without pictures, on a machine that has little.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from models.detector import relocated, weights_file
from models.network.voxelnet import VoxelNet
from models.training.calibration import calibrated_on
from models.training.checkpoint import CHECKPOINT
from models.training.faces import with_faces
from models.training.log import LOG
from models.training.loop import LOG_STEPS, train
from models.training.options import TrainingOptions, parsed
from models.training.packed import PackedFrames
from models.training.presets import ANYWHERE, PRESETS, area_for, config_for
from models.training.validation import validation
from models.training.widening import widened
from models.weight_files import Header, load_weights, save_weights
from toolkit.runtime.files import check_output
from toolkit.sites.files import load_site

WEIGHTS = "weights.safetensors"


def run(
    site: str | None,
    options: TrainingOptions,
    *,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> tuple[Path, dict[str, float]]:
    """Train with the options of `coview train` and write the weights; their file, and the last figures of validation.

    site: a built-in one, a site file, "general", or None for the area that the data shares. Called again with the same
    options, it goes on. Raises what `train` raises, and FileExistsError where the folder holds other weights.
    """
    preset = options.preset or ("general" if site == "general" else "fast")
    device = options.device or ("cuda" if torch.cuda.is_available() else "cpu")
    place = None if site in (None, "general") else load_site(site)
    area = tuple(place.area.tolist()) if place else area_for("general" if site else preset, options.data)
    named: dict[str, Any] = {n: getattr(options, n) for n in ("epochs", "batch", "learning_rate")}
    settings = replace(PRESETS[preset], seed=options.seed, **{name: value for name, value in named.items() if value})
    before = load_weights(weights_file(options.start))[0] if options.start else None
    classes, faces, calibrate = second_stages(options, before)
    config = config_for(area, preset, options.size, classes)
    if options.voxel is not None:
        config = replace(config, voxel_size=(options.voxel, options.voxel, config.voxel_size[2]))
    weights = options.out / WEIGHTS
    _check_folder(options)
    start = None if before is None else widened(before, config)
    validate = validation(options.validate, count=options.validate_frames, device=device) if options.validate else None
    if options.threads:
        torch.set_num_threads(options.threads)
    measured: dict[str, float] = {}

    def measure(network: VoxelNet) -> dict[str, float]:
        measured.update(validate(network))  # type: ignore[misc]
        return dict(measured)

    network = train(
        options.data, config, settings, options.out, start=start, device=device, workers=options.workers,
        bfloat16=options.bfloat16 or device == "cuda",
        every_s=options.checkpoint_s, validate=measure if validate else None, progress=progress,
    )  # fmt: skip
    if faces:
        network = with_faces(network, PackedFrames(options.data), faces, seed=options.seed)
    if calibrate and options.validate:
        network = calibrated_on(network, PackedFrames(options.validate), count=options.validate_frames)
    if validate and (faces or calibrate):
        measure(network)
    trained_for = place.name if place else "general" if area == ANYWHERE else options.data.stem
    save_weights(weights, relocated(network, area, "general"), Header(trained_for, options.seed, commit(), measured))
    return weights, measured


def second_stages(options: TrainingOptions, start: VoxelNet | None) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    """Classes, classes whose faces are measured, and whether scores are calibrated: what the options say, and where
    they say nothing as the network is that training starts from. Raises ValueError for faces of other classes."""
    classes, faces = options.classes, options.faces
    if classes is None:
        classes = ("vehicle",) if start is None else start.config.labels
    if faces is None:
        faces = () if start is None else tuple(name for name in start.config.faces if name in classes)
    calibrate = options.calibrate or (start is not None and bool(start.config.calibration))
    if not set(faces) <= set(classes):
        raise ValueError(f"--faces must be among --classes {' '.join(classes)}, got {' '.join(faces)}")
    return classes, faces, calibrate


def _check_folder(options: TrainingOptions) -> None:
    """Refuse weights that no training here has made; with `overwrite`, forget the training that was here."""
    check_output(options.out / WEIGHTS, inputs=[weights_file(options.start)] if options.start else [], overwrite=True)
    if options.overwrite:
        for name in (CHECKPOINT, LOG):
            (options.out / name).unlink(missing_ok=True)
    elif not (options.out / CHECKPOINT).exists():
        check_output(options.out / WEIGHTS)


def commit() -> str:
    """The commit this code is at, or "unknown" outside a checkout."""
    here = Path(__file__).parent
    try:
        done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return "unknown"
    return done.stdout.strip() or "unknown"


def main(arguments: Sequence[str] | None = None) -> None:
    """`coview train` on a machine that has torch, numpy, h5py, safetensors, scipy and shapely only: no pictures."""
    site, options = parsed(arguments)
    started = time.monotonic()

    def report(step: int, total: int, figures: dict[str, float]) -> None:
        if step % LOG_STEPS == 0 or step == total or "AP@0.7" in figures:
            text = "  ".join(f"{name} {value:.4f}" for name, value in figures.items())
            print(f"{time.monotonic() - started:8.0f} s  step {step}/{total}  {text}", flush=True)

    try:
        weights, _ = run(site, options, progress=report)
    except (ValueError, OSError) as error:
        sys.exit(f"models.train: {error}")
    print(f"written to {weights}")


if __name__ == "__main__":
    main()
