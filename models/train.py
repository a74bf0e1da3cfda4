"""Training on a bare machine, as `coview train` without pictures: packed recordings in, a weights
file out.

python -m models.train tjunction --data train.packed --validate test.packed --out runs/tjunction
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import torch

from models.config import VoxelNetConfig
from models.detector_loading import relocate, weights_file
from models.network.voxelnet import VoxelNet
from models.training.loop import CHECKPOINT, LOG_STEPS, Machine, Progress, train
from models.training.options import TrainingOptions, parse_arguments
from models.training.packed import Area, PackedFrames
from models.training.preset import Preset
from models.training.presets import ANYWHERE, PRESETS, choose_area, make_config
from models.training.second_stage import compute_recording_ap, fit_calibration, train_faces, widen
from models.training.training_log import LOG
from models.weight_files import WeightsHeader, load_weights, save_weights
from toolkit.runtime.output_checks import check_output
from toolkit.runtime.resumable import ShardFolder
from toolkit.runtime.text_tables import escape
from toolkit.sites.files import load_site

WEIGHTS = "weights.safetensors"


def run_training(
    site: str | None, options: TrainingOptions, *, progress: Progress | None = None
) -> tuple[Path, dict[str, float]]:
    """Train or resume with the options of `coview train`; return the weights file and the last
    validation figures.

    site: a built-in one, a site file, "general", or None for the area that the data shares. Raises
    the errors of `train`, and FileExistsError if the folder holds other weights, or another run
    trains there.
    """
    task = _read_task(site, options)
    weights = options.out / WEIGHTS
    inputs = [weights_file(options.start)] if options.start else []
    check_output(weights, inputs=inputs, overwrite=True)
    with ShardFolder(options.out, {}).lock():
        _prepare_folder(options)
        start = None if task.start is None else widen(task.start, task.config)
        validation = None
        if options.validate:
            frames = PackedFrames(options.validate)
            validation = Validation(frames, options.validate_frames, task.machine.device)
        if options.threads:
            torch.set_num_threads(options.threads)
        network = train(
            options.data,
            task.config,
            task.preset,
            options.out,
            start=start,
            machine=task.machine,
            validate=validation,
            progress=progress,
        )
        network = _train_second_stages(network, task.stages, options, validation)
        figures = {} if validation is None else validation.figures
        header = WeightsHeader(
            site=task.trained_for, seed=options.seed, commit=commit(), ap=figures
        )
        save_weights(weights, relocate(network, task.area, "general"), header)
    return weights, figures


class _Task(NamedTuple):
    """Training that the options ask for.

    Attributes:
        area: Area to train for.
        trained_for: Name of the area in the weights file.
        preset: Settings of the training.
        config: Shape of the network.
        stages: Classes and second stages.
        start: Network to start from.
        machine: Hardware.
    """

    area: Area
    trained_for: str
    preset: Preset
    config: VoxelNetConfig
    stages: "SecondStages"
    start: VoxelNet | None
    machine: Machine


def _read_task(site: str | None, options: TrainingOptions) -> _Task:
    """Read the options, and the files that they name.

    site: name or file of the site to train for, "general" for any place, None for the area of the
    training data (or any place, by the preset)."""
    name = options.preset or ("general" if site == "general" else "fast")
    device = options.device or ("cuda" if torch.cuda.is_available() else "cpu")
    site_map = None if site in (None, "general") else load_site(site)
    if site_map:
        area = tuple(site_map.area.tolist())
        trained_for = site_map.name
    else:
        area = choose_area("general" if site else name, options.data)
        trained_for = "general" if area == ANYWHERE else options.data.stem
    preset = _change_preset(PRESETS[name], options)
    start = load_weights(weights_file(options.start))[0] if options.start else None
    stages = second_stages(options, start)
    config = make_config(area, name, options.size, stages.classes)
    if options.voxel is not None:
        config = replace(config, voxel_size=(options.voxel, options.voxel, config.voxel_size[2]))
    machine = Machine(
        device,
        bfloat16=options.bfloat16 or device == "cuda",
        workers=options.workers,
        checkpoint_s=options.checkpoint_s,
        seconds=options.seconds,
    )
    return _Task(area, trained_for, preset, config, stages, start, machine)


def _prepare_folder(options: TrainingOptions) -> None:
    """Remove a run to overwrite. Raises FileExistsError for weights without a checkpoint."""
    if options.overwrite:
        for name in (CHECKPOINT, LOG):
            (options.out / name).unlink(missing_ok=True)
    elif not (options.out / CHECKPOINT).exists():
        check_output(options.out / WEIGHTS)


@dataclass
class Validation:
    """Score of networks on other frames.

    Attributes:
        frames: The frames.
        count: Number of frames to use.
        device: Device of PyTorch.
        figures: Figures of the last network.
    """

    frames: PackedFrames
    count: int | None
    device: str
    figures: dict[str, float] = field(default_factory=dict)

    def __call__(self, network: VoxelNet) -> dict[str, float]:
        """Score a network, and return its figures."""
        self.figures |= compute_recording_ap(
            network, self.frames, count=self.count, device=self.device
        )
        return dict(self.figures)


def _train_second_stages(
    network: VoxelNet,
    stages: "SecondStages",
    options: TrainingOptions,
    validation: Validation | None,
) -> VoxelNet:
    """Train the second stages of a network, and score it again.

    stages: for which classes the faces of boxes are measured, and whether scores are calibrated;
    validation: frames to calibrate and score on, None for neither."""
    if stages.faces:
        data = PackedFrames(options.data)
        network = train_faces(network, data, stages.faces, seed=options.seed)
    if stages.calibrate and validation is not None:
        network = fit_calibration(network, validation.frames, count=validation.count)
    if validation is not None and (stages.faces or stages.calibrate):
        validation(network)  # which keeps the figures
    return network


def _change_preset(preset: Preset, options: TrainingOptions) -> Preset:
    """Return a preset with the values that the options give."""
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
    """Choose the classes and second stages of a training.

    start: network from which the training goes on; the options that are None are as in it. Raises
    ValueError for faces of other classes."""
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
    """Return the commit of this checkout, "unknown" outside one."""
    here = Path(__file__).parent
    try:
        process = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return "unknown"
    return process.stdout.strip() or "unknown"


def train_from_command_line(arguments: Sequence[str] | None = None) -> None:
    """Train from the command line of a machine without coview, and print progress and result.

    arguments: words of the command line, None for the process's. A fault of the input ends
    the process with its text."""
    site, options = parse_arguments(arguments)
    started = time.monotonic()

    def report(step: int, total: int, figures: dict[str, float]) -> None:
        if step % LOG_STEPS == 0 or step == total or "AP@0.7" in figures:
            text = "  ".join(f"{name} {value:.4f}" for name, value in figures.items())
            print(f"{time.monotonic() - started:8.0f} s  step {step}/{total}  {text}", flush=True)

    try:
        weights, _ = run_training(site, options, progress=report)
    except (ValueError, OSError) as error:
        sys.exit(f"models.train: {escape(' '.join(str(error).split()))}")
    print(f"written to {escape(weights)}")


if __name__ == "__main__":
    train_from_command_line()
