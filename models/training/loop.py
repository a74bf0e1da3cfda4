"""Training loop that resumes after an interruption, on CPU and CUDA.

Step s of a run always sees the same examples, so weights, optimiser, schedule and step number are
the whole state."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from models import weight_files
from models.config import VoxelNetConfig
from models.network.grid import anchors
from models.network.voxelnet import VoxelNet
from models.training.losses import paper_loss, quality_loss
from models.training.packed import PackedFrames
from models.training.preset import Preset, check_fit
from models.training.samples import Batch, Samples, stack
from models.training.state import Loss, TrainingState, start_training
from models.training.training_log import LOG, add_figures, cut_log

CHECKPOINT = "checkpoint.pt"
CLOCK_CYCLE_STEPS = 10_000  # parts of a cycle of the learning rate by the clock
MAX_TRAIN_STEPS = 1 << 40
LOG_STEPS = 50  # steps per logged mean of the losses
Progress = Callable[[int, int, dict[str, float]], None]  # step, number of steps, losses or figures
Score = Callable[[VoxelNet], dict[str, float]]


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


def train(
    data: Path,
    config: VoxelNetConfig,
    preset: Preset,
    out: Path,
    *,
    start: VoxelNet | None = None,
    machine: Machine | None = None,
    validate: Score | None = None,
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
    _check_schedule(preset, machine)
    check_fit(config, preset)
    out.mkdir(parents=True, exist_ok=True)
    frames = PackedFrames(data)
    samples = Samples(frames, config, recipe=preset.examples, seed=preset.seed)
    per_epoch = max(1, len(samples) // preset.readings)
    total = max(1, round(preset.epochs * per_epoch))
    if machine.seconds:
        total = CLOCK_CYCLE_STEPS
    state = start_training(config, preset, total, per_epoch, machine.device)
    identity = _identify(config, preset, len(frames), machine)
    if start is not None:
        identity["start"] = _copy_weights(start, state.network)
    if (out / CHECKPOINT).exists():
        checkpoint = weight_files.read_checkpoint(
            out / CHECKPOINT, machine.device, identity=identity
        )
        with weight_files.checkpoint_errors(out / CHECKPOINT):
            state.restore(checkpoint, MAX_TRAIN_STEPS if machine.seconds else total)
    cut_log(out / LOG, state.step)
    last = total
    if machine.seconds:
        last = MAX_TRAIN_STEPS if state.spent < machine.seconds else state.step
    steps: Any = _list_examples(preset, len(samples), per_epoch, range(state.step, last))
    loader = torch.utils.data.DataLoader(
        samples, batch_sampler=steps, collate_fn=stack, num_workers=machine.workers
    )
    loss_of: Loss = paper_loss
    if preset.loss == "quality":
        loss_of = partial(quality_loss, classes=config.anchor_labels)
    anchor = anchors(config).to(machine.device)
    course = _Course(
        state, out, machine, per_epoch, total, identity, loss_of, anchor, validate, progress
    )
    course.run(loader)
    return state.network


def _check_schedule(preset: Preset, machine: Machine) -> None:
    """Raise ValueError for a schedule that cannot follow the clock."""
    if machine.seconds is not None and preset.schedule != "one-cycle":
        raise ValueError(
            f"seconds need a schedule of one cycle, got {preset.schedule!r}: pass epochs"
        )


def _identify(
    config: VoxelNetConfig, preset: Preset, frames: int, machine: Machine
) -> dict[str, object]:
    """Return what a checkpoint must share with the run that resumes from it.

    frames: number of frames to train on. "start" is replaced by the digest of the weights to start
    from, if there are any. Usual values are "", so that older checkpoints, without them, fit."""
    is_coarse = machine.bfloat16 and machine.device == "cpu"
    return {
        "config": config.to_dict(),
        "preset": asdict(preset),
        "frames": frames,
        "start": "",
        "bfloat16": True if is_coarse else "",
        "seconds": machine.seconds or "",
    }


def _copy_weights(start: VoxelNet, network: VoxelNet) -> str:
    """Copy the weights of `start` into a network, and return their digest."""
    weights = start.state_dict()
    weight_files.check_tensors(network.state_dict(), weights, "the network to start from")
    network.load_state_dict(weights)
    return weight_files.digest_tensors(weights)


@dataclass
class _Course:
    """Steps of a training, with its log, validation and checkpoints.

    Attributes:
        state: Training in progress.
        out: Folder of log and checkpoint.
        machine: Hardware.
        per_epoch: Steps of an epoch.
        total: Number of steps, an estimate if the machine limits the time.
        identity: Settings that a checkpoint must share.
        loss_of: Loss of a prediction.
        anchor: Anchors of the network.
        validate: Called with the network after each epoch.
        progress: Called after each step and validation."""

    state: TrainingState
    out: Path
    machine: Machine
    per_epoch: int
    total: int
    identity: dict[str, object]
    loss_of: Loss
    anchor: Tensor
    validate: Score | None
    progress: Progress | None

    def run(self, batches: Iterable[Batch]) -> None:
        """Train on batches until the last step.

        After each epoch the network is validated and a checkpoint saved; one is saved too whenever
        `checkpoint_s` seconds have passed since the last."""
        state = self.state
        # time (s) of the last checkpoint
        saved = time.monotonic()
        # a resumed training counts as begun earlier, by the time that it has already taken
        began = saved - state.spent
        for batch in batches:
            losses = state.learn(
                batch.to(self.machine.device),
                self.loss_of,
                self.anchor,
                bfloat16=self.machine.bfloat16,
            )
            state.recent.append(losses)
            state.step += 1
            state.spent = time.monotonic() - began
            self.advance_schedule()
            self.report(losses)
            is_last = state.step == self.total
            if state.step % LOG_STEPS == 0 or is_last:
                self.log_losses(losses)
            ends_epoch = state.step % self.per_epoch == 0 or is_last
            if ends_epoch and self.validate:
                figures = self.validate(state.network)
                self.log(figures)
                self.report(figures)
            if ends_epoch or time.monotonic() - saved > self.machine.checkpoint_s:
                self.save()
                saved = time.monotonic()
            if is_last:
                break

    def advance_schedule(self) -> None:
        """Advance the learning rate by a step, or to the time that has passed if time is limited.

        Then `total` becomes the number of steps expected in this time."""
        state = self.state
        seconds = self.machine.seconds
        if seconds:
            share = min(state.spent / seconds, 1.0)
            # one less, as the scheduler's step adds one
            state.scheduler.last_epoch = int(share * (CLOCK_CYCLE_STEPS - 1)) - 1
            self.total = state.step
            if share < 1:
                self.total += max(1, round(state.step * (1 / share - 1)))
        state.scheduler.step()

    def report(self, figures: dict[str, float]) -> None:
        """Call `progress` with the figures of the step."""
        if self.progress:
            self.progress(self.state.step, self.total, figures)

    def log(self, figures: dict[str, float]) -> None:
        """Append figures of the step to the log."""
        step = self.state.step
        add_figures(self.out / LOG, step, step / self.per_epoch, figures)

    def log_losses(self, names: Iterable[str]) -> None:
        """Append the means of the losses since the last row."""
        means = {}
        for name in names:
            means[name] = float(np.mean([losses[name] for losses in self.state.recent]))
        self.log(means)
        self.state.recent.clear()

    def save(self) -> None:
        """Write a checkpoint."""
        content = {**self.identity, **self.state.state()}
        weight_files.save_atomically(self.out / CHECKPOINT, content)


def _list_examples(
    preset: Preset, frames: int, per_epoch: int, steps: range
) -> Iterator[list[tuple[int, int]]]:
    """Yield the examples of each step: pairs of epoch and frame, in an order drawn for each epoch.

    frames: number of frames; per_epoch: number of steps in an epoch; steps: steps to yield."""
    order = np.empty(0, int)
    drawn_epoch = -1
    for step in steps:
        epoch, step_in_epoch = divmod(step, per_epoch)
        if epoch != drawn_epoch:
            order = np.random.default_rng([preset.seed, epoch]).permutation(frames)
            drawn_epoch = epoch
        first = step_in_epoch * preset.readings
        yield [(epoch, int(k)) for k in order[first : first + preset.readings]]
