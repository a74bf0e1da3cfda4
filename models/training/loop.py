"""The training loop, the same on CPU and CUDA, that goes on after a kill as if nothing had happened.

Step s of a run always sees the same examples, so weights, optimiser, schedule and step number are the whole state.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.anchors import anchors
from models.network.voxelnet import Prediction, VoxelNet
from models.training import log
from models.training.checkpoint import CHECKPOINT, check_identity, checkpoint_errors, read_checkpoint, save_atomically
from models.training.losses import published_loss, quality_loss
from models.training.packed import PackedFrames
from models.training.presets import Preset, check_fit
from models.training.samples import Batch, Samples, stack
from models.weight_files import check_tensors, digest_of

LOG_STEPS = 50  # losses are logged as their mean over so many steps
Loss = Callable[[Prediction, Tensor, Tensor, Tensor], dict[str, Tensor]]


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
    bfloat16: bool = False,
    workers: int = 0,
    every_s: float = 300.0,
    validate: Callable[[VoxelNet], dict[str, float]] | None = None,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> VoxelNet:
    """Train on a packed file and leave `checkpoint.pt` and `log.csv` in `out`; called again, it goes on where it was.

    start: a network of the same shape to go on from, on any area, instead of random weights;
    bfloat16: multiply in that format, the losses are in float32 in any case;
    every_s: seconds between checkpoints; validate: called with the network after each epoch, its figures are logged;
    progress: called with the step, the number of steps and the losses of the step, or the figures of `validate`.
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
    identity["bfloat16"] = True if bfloat16 and device == "cpu" else ""
    if start is not None:
        check_tensors(run.network.state_dict(), start.state_dict(), "the network to start from")
        run.network.load_state_dict(start.state_dict())
        identity["start"] = digest_of(start.state_dict())
    _resume(run, out / CHECKPOINT, identity, device)
    log.cut(out / log.LOG, run.step)

    by_class: Loss = partial(quality_loss, classes=config.anchor_labels)
    loss_of = by_class if preset.loss == "quality" else published_loss
    anchor = anchors(config).to(device)
    loader = torch.utils.data.DataLoader(
        samples,
        batch_sampler=_Steps(preset, len(samples), per_epoch, run.step, total),
        collate_fn=stack,
        num_workers=workers,
    )
    saved = time.monotonic()
    for batch in loader:
        losses = _step(run, batch.to(device), loss_of, anchor, bfloat16)
        run.recent.append(losses)
        run.step += 1
        if progress:
            progress(run.step, total, losses)
        if run.step % LOG_STEPS == 0 or run.step == total:
            means = {name: float(np.mean([losses[name] for losses in run.recent])) for name in losses}
            log.add(out / log.LOG, run.step, run.step / per_epoch, means)
            run.recent.clear()
        end_of_epoch = run.step % per_epoch == 0 or run.step == total
        if end_of_epoch and validate:
            figures = validate(run.network)
            log.add(out / log.LOG, run.step, run.step / per_epoch, figures)
            if progress:
                progress(run.step, total, figures)
        if end_of_epoch or time.monotonic() - saved > every_s:
            save_atomically(out / CHECKPOINT, {**identity, **run.state()})
            saved = time.monotonic()
    return run.network


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
    check_identity(path, state, identity)
    with checkpoint_errors(path):
        run.restore(state)


def _step(run: Run, batch: Batch, loss_of: Loss, anchor: Tensor, bfloat16: bool) -> dict[str, float]:
    with torch.autocast(anchor.device.type, torch.bfloat16, enabled=bfloat16):
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
