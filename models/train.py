"""Training: one loop, the same on CPU and CUDA, that goes on after a kill as if nothing had happened.

Step s of a run always sees the same examples, so weights, optimiser, schedule and step number are the whole state.

    python -m models.train tjunction --data train.packed --validate test.packed --out runs/tjunction
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from models import training_log
from models.anchors import anchors
from models.config import VoxelNetConfig
from models.detector import moved, weights_file
from models.losses import published_loss, quality_loss
from models.packed import PackedFrames
from models.samples import Batch, SampleRecipe, Samples, stack
from models.tensor_files import load_tensors
from models.training_options import TrainingOptions, parsed
from models.validation import validation
from models.voxelnet import Prediction, VoxelNet
from models.weights import Header, check_tensors, digest_of, load_weights, save_weights
from toolkit.runtime.files import check_output, write_bytes
from toolkit.sites.files import load_site

CHECKPOINT, LOG, WEIGHTS = "checkpoint.pt", "log.csv", "weights.safetensors"
LOG_STEPS = 50  # losses are logged as their mean over so many steps
WINDOW = 40.0  # m; networks that know no absolute coordinates learn on windows of at most this side
ANYWHERE = (-WINDOW / 2, -WINDOW / 2, WINDOW / 2, WINDOW / 2)
Loss = Callable[[Prediction, Tensor, Tensor, Tensor], dict[str, Tensor]]


@dataclass(frozen=True)
class Preset:
    """Everything that decides how a network is trained, beside the network and the data."""

    epochs: float = 4.0
    batch: int = 4
    optimiser: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 3e-3
    weight_decay: float = 0.01
    schedule: Literal["one-cycle", "step"] = "one-cycle"
    loss: Literal["quality", "published"] = "quality"
    examples: SampleRecipe = field(default_factory=SampleRecipe)
    seed: int = 0


PRESETS = {
    "fast": Preset(),
    "paper": Preset(
        epochs=30.0, batch=1, optimiser="sgd", learning_rate=1e-3, weight_decay=1e-4, schedule="step", loss="published",
        examples=SampleRecipe(subsets=0.0, augmentation="object", positive=0.6, negative=0.6, sampled=256, seen=0),
    ),
    "general": Preset(examples=SampleRecipe(augmentation="scene")),
}  # fmt: skip


@dataclass
class Run:
    """A training in progress: what is saved in a checkpoint and nothing else.

    recent: the losses of the steps since the last row of the log, whose mean the next row is.
    """

    network: VoxelNet
    optimiser: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    step: int = 0
    recent: list[dict[str, float]] = field(default_factory=list)

    def state(self) -> dict[str, Any]:
        """Plain tensors and numbers; torch's generator too, though the loop draws nothing from it."""
        return {
            "network": self.network.state_dict(), "optimiser": self.optimiser.state_dict(),
            "scheduler": self.scheduler.state_dict(), "step": self.step, "rng": torch.get_rng_state(),
            "recent": self.recent,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.scheduler.load_state_dict(state["scheduler"])
        torch.set_rng_state(state["rng"].cpu())
        self.step, self.recent = state["step"], list(state.get("recent", []))


def train(
    data: Path,
    config: VoxelNetConfig,
    preset: Preset,
    out: Path,
    *,
    start: VoxelNet | None = None,
    device: str = "cpu",
    workers: int = 0,
    every_s: float = 300.0,
    validate: Callable[[VoxelNet], dict[str, float]] | None = None,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> VoxelNet:
    """Train on a packed file and leave `checkpoint.pt` and `log.csv` in `out`; called again, it goes on where it was.

    start: a network of the same shape to go on from, on any area, instead of random weights;
    every_s: seconds between checkpoints; validate: called with the network after each epoch, its figures are logged;
    progress: told the step, the number of steps and the losses of the step, or the figures of `validate`.
    Raises ValueError where preset and network do not fit, and where `out` holds a run of other settings.
    """
    check_fit(config, preset)
    out.mkdir(parents=True, exist_ok=True)
    frames = PackedFrames(data)
    samples = Samples(frames, config, preset.examples, preset.seed)
    per_epoch = max(1, len(samples) // preset.batch)
    total = max(1, round(preset.epochs * per_epoch))
    run = _start(config, preset, total, per_epoch, device)
    identity = {"config": config.to_dict(), "preset": asdict(preset), "frames": len(frames), "start": ""}
    if start is not None:
        check_tensors(run.network.state_dict(), start.state_dict(), "the network to start from")
        run.network.load_state_dict(start.state_dict())
        identity["start"] = digest_of(start.state_dict())
    _resume(run, out / CHECKPOINT, identity, device)
    training_log.cut(out / LOG, run.step)

    loss_of: Loss = quality_loss if preset.loss == "quality" else published_loss
    anchor = anchors(config).to(device)
    loader = torch.utils.data.DataLoader(
        samples,
        batch_sampler=_Steps(preset, len(samples), per_epoch, run.step, total),
        collate_fn=stack,
        num_workers=workers,
    )
    saved = time.monotonic()
    for batch in loader:
        losses = _step(run, batch.to(device), loss_of, anchor)
        run.recent.append(losses)
        run.step += 1
        if progress:
            progress(run.step, total, losses)
        if run.step % LOG_STEPS == 0 or run.step == total:
            means = {name: float(np.mean([losses[name] for losses in run.recent])) for name in losses}
            training_log.add(out / LOG, run.step, run.step / per_epoch, means)
            run.recent.clear()
        end_of_epoch = run.step % per_epoch == 0 or run.step == total
        if end_of_epoch and validate:
            figures = validate(run.network)
            training_log.add(out / LOG, run.step, run.step / per_epoch, figures)
            if progress:
                progress(run.step, total, figures)
        if end_of_epoch or time.monotonic() - saved > every_s:
            save_atomically(out / CHECKPOINT, {**identity, **run.state()})
            saved = time.monotonic()
    return run.network


def config_for(area: tuple[float, float, float, float], preset: str, size: str = "light") -> VoxelNetConfig:
    """The network a preset trains for an area: light or published in size, with the head its loss needs.

    The light one knows no absolute coordinates, so it learns on a `window` of the area; `models.detector.moved` puts
    what it learned on all of it.
    """
    quality = {"head": "quality", "anchor_z": 0.8, "quality_power": 1.0, "averaging": 0.75}
    published = {"head": "published", "anchor_z": 1.6, "quality_power": 0.0, "averaging": 0.0}
    head = published if PRESETS[preset].loss == "published" else quality
    if size == "light":
        return VoxelNetConfig.light(window(area), **head)
    voxel = (0.4, 0.4, 0.4) if max(area[2] - area[0], area[3] - area[1]) > 80 else (0.2, 0.2, 0.4)
    return VoxelNetConfig(area=area, voxel_size=voxel, **head)  # type: ignore[arg-type]


def window(area: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """The middle of an area (xmin ymin xmax ymax, m), at most `WINDOW` wide.

    >>> window((-40.0, -20.0, 40.0, 10.0))
    (-20.0, -20.0, 20.0, 10.0)
    """
    xmin, ymin, xmax, ymax = area
    x, y = max(0.0, xmax - xmin - WINDOW) / 2, max(0.0, ymax - ymin - WINDOW) / 2
    return xmin + x, ymin + y, xmax - x, ymax - y


def check_fit(config: VoxelNetConfig, preset: Preset) -> None:
    """Raise ValueError where a preset's loss is for another head, or it cannot train anything."""
    if config.head != preset.loss:
        raise ValueError(f"the {preset.loss} loss trains a network with that head, got head {config.head!r}")
    if preset.batch < 1 or not preset.epochs > 0:
        raise ValueError(f"need a batch of at least 1 and epochs above 0, got {preset.batch} and {preset.epochs}")


def save_atomically(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint that is whole under its name, or not there."""
    content = BytesIO()
    torch.save(state, content)
    write_bytes(path, content.getvalue())


def read_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """What `save_atomically` wrote. Nothing in the file is executed. Raises ValueError where it is damaged."""
    try:
        state = load_tensors(path, device)
    except ValueError as error:
        raise ValueError(f"{error}: remove it to begin anew") from None
    if not isinstance(state, dict):
        raise ValueError(f"{path} is no checkpoint: remove it to begin anew, or choose another folder")
    return state


def load_checkpoint(path: Path) -> tuple[VoxelNet, dict[str, Any]]:
    """The network of a checkpoint and the settings it was trained with. Raises ValueError where it is damaged."""
    state = read_checkpoint(path)
    with _checkpoint_errors(path):
        network = VoxelNet(VoxelNetConfig.from_dict(state["config"]))
        check_tensors(network.state_dict(), state["network"], path)
        network.load_state_dict(state["network"])
        return network.eval(), {"preset": state["preset"], "step": state["step"], "frames": state["frames"]}


def commit() -> str:
    """The commit this code is at, or "unknown" outside a checkout."""
    here = Path(__file__).parent
    try:
        done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return "unknown"
    return done.stdout.strip() or "unknown"


class _Steps:
    """The examples of each step, from step `start` on: (epoch, frame) pairs of a permutation drawn for each epoch."""

    def __init__(self, preset: Preset, frames: int, per_epoch: int, start: int, total: int) -> None:
        self.preset, self.frames, self.per_epoch, self.start, self.total = preset, frames, per_epoch, start, total

    def __len__(self) -> int:
        return self.total - self.start

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        order, drawn = np.empty(0, int), -1
        for step in range(self.start, self.total):
            epoch, place = divmod(step, self.per_epoch)
            if epoch != drawn:
                order, drawn = np.random.default_rng([self.preset.seed, epoch]).permutation(self.frames), epoch
            first = place * self.preset.batch
            yield [(epoch, int(k)) for k in order[first : first + self.preset.batch]]


def _start(config: VoxelNetConfig, preset: Preset, total: int, per_epoch: int, device: str) -> Run:
    torch.manual_seed(preset.seed)
    network = VoxelNet(config).to(device)
    if not config.middle_widths:
        network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    parameters = network.train().parameters()
    optimiser: torch.optim.Optimizer
    if preset.optimiser == "sgd":
        optimiser = torch.optim.SGD(parameters, preset.learning_rate, momentum=0.9, weight_decay=preset.weight_decay)
    else:
        optimiser = torch.optim.AdamW(parameters, preset.learning_rate, weight_decay=preset.weight_decay)
    schedule: torch.optim.lr_scheduler.LRScheduler
    if preset.schedule == "one-cycle":
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, preset.learning_rate, total_steps=max(total, 10), pct_start=0.2
        )
    else:
        schedule = torch.optim.lr_scheduler.MultiStepLR(optimiser, [10 * per_epoch], gamma=0.1)
    return Run(network, optimiser, schedule)


def _resume(run: Run, path: Path, identity: dict[str, Any], device: str) -> None:
    if not path.exists():
        return
    state = read_checkpoint(path, device)
    different = [key for key in identity if _plain(state.get(key, "")) != _plain(identity[key])]
    if different:
        raise ValueError(
            f"{path} belongs to a run with another {' and '.join(different)}: choose another folder or --overwrite it"
        )
    with _checkpoint_errors(path):
        run.restore(state)


@contextmanager
def _checkpoint_errors(path: Path) -> Iterator[None]:
    """One line for a checkpoint that can be read and does not fit."""
    try:
        yield
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:80]
        raise ValueError(f"{path} is no checkpoint of this training ({reason}): remove it to begin anew") from None


def _plain(value: Any) -> Any:
    """Tuples as lists, so that settings compare equal after a round trip."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _step(run: Run, batch: Batch, loss_of: Loss, anchor: Tensor) -> dict[str, float]:
    with torch.autocast(anchor.device.type, torch.bfloat16, enabled=anchor.is_cuda):
        prediction = run.network(batch.voxels)
    prediction = Prediction(*(None if m is None else m.float() for m in prediction))  # type: ignore[arg-type]
    losses = loss_of(prediction, batch.labels, batch.boxes, anchor)
    loss = torch.stack(list(losses.values())).sum()
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(run.network.parameters(), 10.0)
    run.optimiser.step()
    run.scheduler.step()
    return dict(zip(losses, torch.stack(list(losses.values())).tolist(), strict=True))


def run(
    site: str | None,
    options: TrainingOptions,
    *,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> tuple[Path, dict[str, float]]:
    """Train as `coview train` is told to and write the weights; the weights' file and the last figures of validation.

    site: a built-in one, a site file, "general", or None for the area that the data shares. Called again with the same
    options, it goes on. Raises what `train` raises, and FileExistsError where the folder holds other weights.
    """
    preset = options.preset or ("general" if site == "general" else "fast")
    device = options.device or ("cuda" if torch.cuda.is_available() else "cpu")
    place = None if site in (None, "general") else load_site(site)
    area = tuple(place.area.tolist()) if place else area_for("general" if site else preset, options.data)
    named: dict[str, Any] = {n: getattr(options, n) for n in ("epochs", "batch", "learning_rate")}
    settings = replace(PRESETS[preset], seed=options.seed, **{name: value for name, value in named.items() if value})
    config = config_for(area, preset, options.size)
    if options.voxel is not None:
        config = replace(config, voxel_size=(options.voxel, options.voxel, config.voxel_size[2]))
    weights = options.out / WEIGHTS
    _check_folder(options)
    start = load_weights(weights_file(options.start))[0] if options.start else None
    validate = validation(options.validate, count=options.validate_frames, device=device) if options.validate else None
    if options.threads:
        torch.set_num_threads(options.threads)
    measured: dict[str, float] = {}

    def measure(network: VoxelNet) -> dict[str, float]:
        measured.update(validate(network))  # type: ignore[misc]
        return dict(measured)

    network = train(
        options.data, config, settings, options.out, start=start, device=device, workers=options.workers,
        every_s=options.checkpoint_s, validate=measure if validate else None, progress=progress,
    )  # fmt: skip
    trained_for = place.name if place else "general" if area == ANYWHERE else options.data.stem
    save_weights(weights, moved(network, area, "general"), Header(trained_for, options.seed, commit(), measured))
    return weights, measured


def _check_folder(options: TrainingOptions) -> None:
    """Refuse weights that no training here has made; with `overwrite`, forget the training that was here."""
    check_output(options.out / WEIGHTS, inputs=[weights_file(options.start)] if options.start else [], overwrite=True)
    if options.overwrite:
        for name in (CHECKPOINT, LOG):
            (options.out / name).unlink(missing_ok=True)
    elif not (options.out / CHECKPOINT).exists():
        check_output(options.out / WEIGHTS)


def area_for(preset: str, data: Path) -> tuple[float, float, float, float]:
    """The area to train: any, as large as a window, for `general`, else the one all frames of the data share.

    Raises ValueError where they share none.
    """
    if preset == "general":
        return ANYWHERE
    areas = {rig.area for rig in PackedFrames(data).rigs}
    if len(areas) > 1:
        raise ValueError(f"{data} holds {len(areas)} different areas: give a site, or general")
    return next(iter(areas))


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
