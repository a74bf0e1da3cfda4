"""Training loop that resumes after an interruption, on CPU and CUDA.

Step s of a run always sees the same examples, so weights, optimiser, schedule and step number are
the whole state. The log is a CSV file in long format: step, epoch, name, value.
"""

import csv
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.optim.lr_scheduler import LRScheduler, MultiStepLR, OneCycleLR

from models import weight_files
from models.config import VoxelNetConfig, road_users, select_anchors
from models.network.grid import anchors
from models.network.voxelnet import Prediction, VoxelNet
from models.training.losses import paper_loss, quality_loss
from models.training.packed import Area, PackedFrames
from models.training.samples import Batch, SampleRecipe, Samples, stack
from toolkit.runtime.writing import write_text

WINDOW_M = 40.0  # largest side of the windows for networks without absolute coordinates
ANYWHERE = (-WINDOW_M / 2, -WINDOW_M / 2, WINDOW_M / 2, WINDOW_M / 2)
CHECKPOINT = "checkpoint.pt"
LOG = "log.csv"
CLOCK_CYCLE_STEPS = 10_000  # parts of a cycle of the learning rate by the clock
MAX_TRAIN_STEPS = 1 << 40
LOG_STEPS = 50  # steps per logged mean of the losses
_HEADER = "step,epoch,name,value"
Progress = Callable[[int, int, dict[str, float]], None]  # step, number of steps, losses or figures
Loss = Callable[[Prediction, Tensor, Tensor, Tensor], dict[str, Tensor]]


@dataclass(frozen=True)
class Preset:
    """Settings of a training, apart from network and data.

    Attributes:
        epochs: Passes over the data.
        batch: Examples per step.
        optimiser: Optimiser.
        learning_rate: Highest learning rate.
        weight_decay: Weight decay.
        schedule: Schedule of the learning rate.
        loss: Loss, which matches the network's head.
        examples: Recipe of the examples.
        seed: Seed of weights, order, noise and augmentation.
    """

    epochs: float = 4.0
    batch: int = 4
    optimiser: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 3e-3
    weight_decay: float = 0.01
    schedule: Literal["one-cycle", "step"] = "one-cycle"
    loss: Literal["quality", "published"] = "quality"
    examples: SampleRecipe = field(default_factory=SampleRecipe)
    seed: int = 0

    @property
    def readings(self) -> int:
        """Frames that are read for a step."""
        return self.batch // self.examples.windows


_OBJECTS = SampleRecipe(
    subsets=0.0, augmentation="object", positive=0.6, negative=0.6, sampled=256, seen=0
)
_PAPER = Preset(optimiser="sgd", schedule="step", loss="published", examples=_OBJECTS)
PRESETS = {
    "fast": Preset(),
    "paper": replace(_PAPER, epochs=30.0, batch=1, learning_rate=1e-3, weight_decay=1e-4),
    "general": Preset(
        examples=SampleRecipe(
            augmentation="scene", errors=0.4, thinned=0.3, tilted=0.3, elsewhere=0.2
        )
    ),
    "varied": Preset(examples=SampleRecipe(errors=0.4, thinned=0.2, tilted=0.3, elsewhere=0.2)),
}


def make_config(
    area: Area, preset: str, size: str = "light", classes: Sequence[str] = ("vehicle",)
) -> VoxelNetConfig:
    """Network that a preset trains for an area, light or published in size, with the head of its
    loss.

    The light one has no absolute coordinates, so it learns on a `window` of the area;
    `models.detector.relocate` puts the result on all of it.
    """
    head: dict[str, Any] = {
        "head": "quality",
        "anchor_z": 0.8,
        "quality_power": 1.0,
        "averaging": 0.75,
    }
    if PRESETS[preset].loss == "published":
        head = {"head": "published", "anchor_z": 1.6, "quality_power": 0.0, "averaging": 0.0}
    if tuple(classes) != ("vehicle",):
        head |= road_users(select_anchors(classes))
    if size == "light":
        return VoxelNetConfig.light(window(area), **head)
    voxel = (0.4, 0.4, 0.4) if max(area[2] - area[0], area[3] - area[1]) > 80 else (0.2, 0.2, 0.4)
    return VoxelNetConfig(area=area, voxel_size=voxel, **head)


def window(area: Area, side: float = WINDOW_M) -> Area:
    """Middle of an area (xmin ymin xmax ymax, m), at most `side` wide (m)."""
    xmin, ymin, xmax, ymax = area
    x = max(0.0, xmax - xmin - side) / 2
    y = max(0.0, ymax - ymin - side) / 2
    return xmin + x, ymin + y, xmax - x, ymax - y


def check_fit(config: VoxelNetConfig, preset: Preset) -> None:
    """Raise ValueError if a preset cannot train this network."""
    if config.head != preset.loss:
        raise ValueError(
            f"the {preset.loss} loss needs a network with that head, got head {config.head!r}"
        )
    if len(config.labels) > 1 and not config.kinds:
        raise ValueError(
            f"several labels need anchors of their own, got {config.labels}: give kinds"
        )
    if preset.batch < 1 or not preset.epochs > 0:
        raise ValueError(
            f"need a batch of at least 1 and epochs above 0, got {preset.batch} and {preset.epochs}"
        )
    if preset.batch % preset.examples.windows:
        raise ValueError(
            f"windows must divide the batch, got {preset.examples.windows} for {preset.batch} "
            "examples"
        )


def choose_area(preset: str, data: Path) -> Area:
    """Window of any place for `general`, otherwise the area of all frames.

    Raises ValueError if the areas differ.
    """
    if preset == "general":
        return ANYWHERE
    areas = {rig.area for rig in PackedFrames(data).rigs}
    if len(areas) > 1:
        raise ValueError(f"{data} holds {len(areas)} different areas: give a site, or general")
    return next(iter(areas))


def add_figures(path: Path, step: int, epoch: float, figures: dict[str, float]) -> None:
    """Append figures to the log."""
    rows = path.read_text().splitlines()[1:] if path.exists() else []
    rows += [f"{step},{epoch:.4f},{name},{value}" for name, value in figures.items()]
    write_text(path, "\n".join([_HEADER, *rows, ""]))


def cut_log(path: Path, step: int) -> None:
    """Drop log rows after `step`, the last checkpoint."""
    if path.exists():
        split = [row.split(",") for row in path.read_text().splitlines()[1:]]
        kept_rows = [
            ",".join(row)
            for row in split
            if len(row) == 4 and row[0].isdigit() and int(row[0]) <= step
        ]
        write_text(path, "\n".join([_HEADER, *kept_rows, ""]))


def read_curves(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Epochs and values of each figure, in order."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            epochs, values = curves.setdefault(row["name"], ([], []))
            epochs.append(float(row["epoch"]))
            values.append(float(row["value"]))
    return curves


@dataclass(frozen=True)
class Machine:
    """Hardware that a training runs on.

    Attributes:
        device: Device of PyTorch.
        bfloat16: Whether to multiply in that format; losses stay in float32.
        workers: Processes that prepare examples.
        checkpoint_s: Seconds between checkpoints.
        seconds: Wall time of the whole training, in place of epochs.
    """

    device: str = "cpu"
    bfloat16: bool = False
    workers: int = 0
    checkpoint_s: float = 300.0
    seconds: float | None = None


@dataclass
class TrainingState:
    """Training in progress: exactly a checkpoint's content.

    Attributes:
        network: Network in training.
        optimiser: Optimiser of its weights.
        scheduler: Schedule of the learning rate.
        step: Number of finished steps.
        spent: Seconds so far.
        recent: Losses since the last row of the log.
    """

    network: VoxelNet
    optimiser: torch.optim.Optimizer
    scheduler: LRScheduler
    step: int = 0
    spent: float = 0.0
    recent: list[dict[str, float]] = field(default_factory=list)

    def state(self) -> dict[str, object]:
        """Plain tensors and numbers of the state."""
        modules = {
            name: getattr(self, name).state_dict() for name in ("network", "optimiser", "scheduler")
        }
        return {
            **modules,
            "step": self.step,
            "spent": self.spent,
            "rng": torch.get_rng_state(),
            "recent": self.recent,
        }

    def restore(self, state: dict[str, Any], total: int) -> None:
        """Resume from a state of a run of `total` steps."""
        if type(state["step"]) is not int or not 0 <= state["step"] <= total:
            raise ValueError(
                f"step must be a whole number from 0 to {total}, got {str(state['step'])[:40]}"
            )
        for name in ("network", "optimiser", "scheduler"):
            getattr(self, name).load_state_dict(state[name])
        torch.set_rng_state(state["rng"].cpu())
        self.step = state["step"]
        self.spent = float(state.get("spent", 0.0))
        self.recent = []
        for losses in state.get("recent", []):
            self.recent.append({name: float(loss) for name, loss in losses.items()})


def train(
    data: Path,
    config: VoxelNetConfig,
    preset: Preset,
    out: Path,
    *,
    start: VoxelNet | None = None,
    machine: Machine | None = None,
    validate: Callable[[VoxelNet], dict[str, float]] | None = None,
    progress: Progress | None = None,
) -> VoxelNet:
    """Train on a packed file, or resume from `checkpoint.pt` and `log.csv` in `out`.

    start: a network of the same shape, on any area, to start from instead of random weights;
    machine: the CPU by default; validate: called with the network after each epoch, and its figures
    are logged; progress: called with the step, the number of steps, and the losses of the step or
    the figures of `validate`. With `Machine.seconds` the cycle of the learning rate follows the
    clock, which resuming sets back to the last checkpoint, and the number of steps is an estimate.
    Raises ValueError if preset and network do not fit, or if `out` holds a run with other settings.
    """
    machine = machine or Machine()
    device = machine.device
    bfloat16 = machine.bfloat16
    seconds = machine.seconds
    if seconds is not None and preset.schedule != "one-cycle":
        raise ValueError(
            f"seconds need a schedule of one cycle, got {preset.schedule!r}: say epochs"
        )
    check_fit(config, preset)
    out.mkdir(parents=True, exist_ok=True)
    frames = PackedFrames(data)
    samples = Samples(frames, config, preset.examples, preset.seed)
    per_epoch = max(1, len(samples) // preset.readings)
    total = CLOCK_CYCLE_STEPS if seconds else max(1, round(preset.epochs * per_epoch))
    run = _start(config, preset, total, per_epoch, device)
    identity = {
        "config": config.to_dict(),
        "preset": asdict(preset),
        "frames": len(frames),
        "start": "",
    }
    identity |= {"bfloat16": True if bfloat16 and device == "cpu" else "", "seconds": seconds or ""}
    if start is not None:
        weight_files.check_tensors(
            run.network.state_dict(), start.state_dict(), "the network to start from"
        )
        run.network.load_state_dict(start.state_dict())
        identity["start"] = weight_files.digest_tensors(start.state_dict())
    if (out / CHECKPOINT).exists():
        state = weight_files.read_checkpoint(out / CHECKPOINT, device, identity=identity)
        with weight_files.checkpoint_errors(out / CHECKPOINT):
            run.restore(state, MAX_TRAIN_STEPS if seconds else total)
    cut_log(out / LOG, run.step)

    by_class: Loss = partial(quality_loss, classes=config.anchor_labels)
    loss_of = by_class if preset.loss == "quality" else paper_loss
    anchor = anchors(config).to(device)
    last = total
    if seconds:
        last = MAX_TRAIN_STEPS if run.spent < seconds else run.step
    steps: Any = _steps(preset, len(samples), per_epoch, range(run.step, last))
    loader = torch.utils.data.DataLoader(
        samples, batch_sampler=steps, collate_fn=stack, num_workers=machine.workers
    )
    saved = time.monotonic()
    began = saved - run.spent
    for batch in loader:
        losses = _step(run, batch.to(device), loss_of, anchor, bfloat16)
        run.recent.append(losses)
        run.step += 1
        run.spent = time.monotonic() - began
        if seconds:
            share = min(run.spent / seconds, 1.0)
            run.scheduler.last_epoch = int(share * (CLOCK_CYCLE_STEPS - 1)) - 1
            total = run.step + (share < 1) * max(1, round(run.step * (1 / share - 1)))
        run.scheduler.step()
        if progress:
            progress(run.step, total, losses)
        if run.step % LOG_STEPS == 0 or run.step == total:
            means = {}
            for name in losses:
                means[name] = float(np.mean([recent[name] for recent in run.recent]))
            add_figures(out / LOG, run.step, run.step / per_epoch, means)
            run.recent.clear()
        end_of_epoch = run.step % per_epoch == 0 or run.step == total
        if end_of_epoch and validate:
            figures = validate(run.network)
            add_figures(out / LOG, run.step, run.step / per_epoch, figures)
            if progress:
                progress(run.step, total, figures)
        if end_of_epoch or time.monotonic() - saved > machine.checkpoint_s:
            weight_files.save_atomically(out / CHECKPOINT, {**identity, **run.state()})
            saved = time.monotonic()
        if run.step == total:
            break
    return run.network


def _steps(
    preset: Preset, frames: int, per_epoch: int, steps: range
) -> Iterator[list[tuple[int, int]]]:
    """Yield the examples of each step: (epoch, frame) pairs of a permutation drawn for each
    epoch."""
    order = np.empty(0, int)
    drawn_epoch = -1
    for step in steps:
        epoch, step_in_epoch = divmod(step, per_epoch)
        if epoch != drawn_epoch:
            order = np.random.default_rng([preset.seed, epoch]).permutation(frames)
            drawn_epoch = epoch
        yield [
            (epoch, int(k))
            for k in order[step_in_epoch * preset.readings : (step_in_epoch + 1) * preset.readings]
        ]


def _start(
    config: VoxelNetConfig, preset: Preset, total: int, per_epoch: int, device: str
) -> TrainingState:
    torch.manual_seed(preset.seed)
    network = VoxelNet(config).to(device)
    if not config.middle_widths:
        network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    parameters = network.train().parameters()
    rate = preset.learning_rate
    decay = preset.weight_decay
    optimiser: torch.optim.Optimizer = torch.optim.AdamW(parameters, rate, weight_decay=decay)
    if preset.optimiser == "sgd":
        optimiser = torch.optim.SGD(network.parameters(), rate, momentum=0.9, weight_decay=decay)
    if preset.schedule == "step":
        return TrainingState(
            network, optimiser, MultiStepLR(optimiser, [10 * per_epoch], gamma=0.1)
        )
    schedule = OneCycleLR(optimiser, rate, total_steps=max(total, 10), pct_start=0.2)
    return TrainingState(network, optimiser, schedule)


def _step(
    run: TrainingState, batch: Batch, loss_of: Loss, anchor: Tensor, bfloat16: bool
) -> dict[str, float]:
    with torch.autocast(anchor.device.type, torch.bfloat16, enabled=bfloat16):
        prediction = run.network(batch.voxels)
    prediction = Prediction(*(None if m is None else m.float() for m in prediction))  # type: ignore[arg-type]
    losses = loss_of(prediction, batch.labels, batch.boxes, anchor)
    loss = torch.stack(list(losses.values())).sum()
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(run.network.parameters(), 10.0)
    run.optimiser.step()
    return dict(zip(losses, torch.stack(list(losses.values())).tolist(), strict=True))
