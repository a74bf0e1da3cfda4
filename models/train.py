"""Training: one loop, the same on CPU and CUDA, that goes on after a kill as if nothing had happened.

Step s of a run always sees the same examples, so weights, optimiser, schedule and step number are the whole state.

    python -m models.train tjunction.packed --preset fast --area -40 -20 40 20 --out runs/tjunction
"""

from __future__ import annotations

import csv
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from models.anchors import anchors
from models.config import VoxelNetConfig
from models.losses import published_loss, quality_loss
from models.packed import PackedFrames
from models.samples import Batch, SampleRecipe, Samples, stack
from models.voxelnet import Prediction, VoxelNet

CHECKPOINT, LOG = "checkpoint.pt", "log.csv"
Loss = Callable[[Prediction, Tensor, Tensor, Tensor], dict[str, Tensor]]


@dataclass(frozen=True)
class Preset:
    """Everything that decides how a network is trained, beside the network and the data."""

    epochs: float = 3.0
    batch: int = 2
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
        epochs=30, batch=1, optimiser="sgd", learning_rate=1e-3, weight_decay=1e-4, schedule="step", loss="published",
        examples=SampleRecipe(subsets=0, augmentation="object", positive=0.6, negative=0.6, sampled=256, seen=0),
    ),
    "general": Preset(examples=SampleRecipe(augmentation="scene")),
}  # fmt: skip


@dataclass
class Run:
    """A training in progress: what is saved in a checkpoint and nothing else."""

    network: VoxelNet
    optimiser: torch.optim.Optimizer
    scheduler: torch.optim.lr_scheduler.LRScheduler
    step: int = 0

    def state(self) -> dict[str, Any]:
        """Plain tensors and numbers; torch's generator too, though the loop draws nothing from it."""
        return {
            "network": self.network.state_dict(), "optimiser": self.optimiser.state_dict(),
            "scheduler": self.scheduler.state_dict(), "step": self.step, "rng": torch.get_rng_state(),
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.scheduler.load_state_dict(state["scheduler"])
        torch.set_rng_state(state["rng"])
        self.step = state["step"]


def train(
    data: Path,
    config: VoxelNetConfig,
    preset: Preset,
    out: Path,
    *,
    device: str = "cpu",
    workers: int = 0,
    every_s: float = 300.0,
    validate: Callable[[VoxelNet], dict[str, float]] | None = None,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> VoxelNet:
    """Train on a packed file and leave `checkpoint.pt` and `log.csv` in `out`; called again, it goes on where it was.

    every_s: seconds between checkpoints; validate: called with the network after each epoch, its figures are logged.
    Raises ValueError where `out` holds a run of other settings.
    """
    out.mkdir(parents=True, exist_ok=True)
    frames = PackedFrames(data)
    samples = Samples(frames, config, preset.examples, preset.seed)
    per_epoch = max(1, len(samples) // preset.batch)
    total = max(1, round(preset.epochs * per_epoch))
    run = _start(config, preset, total, per_epoch, device)
    identity = {"config": config.to_dict(), "preset": asdict(preset), "frames": len(frames)}
    _resume(run, out / CHECKPOINT, identity, device)
    _forget_later_rows(out / LOG, run.step)

    loss_of: Loss = quality_loss if preset.loss == "quality" else published_loss
    anchor = anchors(config).to(device)
    loader = torch.utils.data.DataLoader(
        samples,
        batch_sampler=_Steps(preset, len(samples), per_epoch, run.step, total),
        collate_fn=stack,
        num_workers=workers,
        persistent_workers=False,
    )
    saved, recent = time.monotonic(), []
    for batch in loader:
        recent.append(_step(run, batch.to(device), loss_of, anchor, device))
        run.step += 1
        if run.step % 50 == 0 or run.step == total:
            figures = {name: float(np.mean([losses[name] for losses in recent])) for name in recent[0]}
            recent.clear()
            _log(out / LOG, run, per_epoch, figures)
            if progress:
                progress(run.step, total, figures)
        end_of_epoch = run.step % per_epoch == 0 or run.step == total
        if end_of_epoch and validate:
            _log(out / LOG, run, per_epoch, validate(run.network))
        if end_of_epoch or time.monotonic() - saved > every_s:
            save_atomically(out / CHECKPOINT, {**identity, **run.state()})
            saved = time.monotonic()
    return run.network


def save_atomically(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint that is whole under its name, or not there."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        torch.save(state, file)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def load_checkpoint(path: Path) -> tuple[VoxelNet, dict[str, Any]]:
    """The network of a checkpoint and the settings it was trained with. Nothing in the file is executed."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    network = VoxelNet(VoxelNetConfig(**state["config"]))
    network.load_state_dict(state["network"])
    return network.eval(), {"preset": state["preset"], "step": state["step"], "frames": state["frames"]}


def commit() -> str:
    """The commit this code is at, or "unknown" outside a checkout."""
    here = Path(__file__).parent
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False)
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
    network = VoxelNet(config).to(device, memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    parameters = network.parameters()
    optimiser: torch.optim.Optimizer
    if preset.optimiser == "sgd":
        optimiser = torch.optim.SGD(parameters, preset.learning_rate, momentum=0.9, weight_decay=preset.weight_decay)
    else:
        optimiser = torch.optim.AdamW(parameters, preset.learning_rate, weight_decay=preset.weight_decay)
    schedule: torch.optim.lr_scheduler.LRScheduler
    if preset.schedule == "one-cycle":
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, preset.learning_rate, total_steps=total, pct_start=0.2
        )
    else:
        schedule = torch.optim.lr_scheduler.MultiStepLR(optimiser, [10 * per_epoch], gamma=0.1)
    return Run(network, optimiser, schedule)


def _resume(run: Run, path: Path, identity: dict[str, Any], device: str) -> None:
    if not path.exists():
        return
    state = torch.load(path, map_location=device, weights_only=True)
    different = [key for key in identity if _plain(state[key]) != _plain(identity[key])]
    if different:
        raise ValueError(
            f"{path} belongs to a run with another {' and '.join(different)}: choose another folder or remove it"
        )
    run.restore({**state, "rng": state["rng"].cpu()})


def _plain(value: Any) -> Any:
    """Tuples as lists, so that settings compare equal after a round trip."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _step(run: Run, batch: Batch, loss_of: Loss, anchor: Tensor, device: str) -> dict[str, float]:
    with torch.autocast(device, torch.bfloat16, enabled=device.startswith("cuda")):
        prediction = run.network(batch.voxels)
    prediction = Prediction(*(None if m is None else m.float() for m in prediction))  # type: ignore[arg-type]
    losses = loss_of(prediction, batch.labels, batch.boxes, anchor)
    loss = torch.stack(list(losses.values())).sum()
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(run.network.parameters(), 10.0)
    run.optimiser.step()
    run.scheduler.step()
    return {name: float(value.detach()) for name, value in losses.items()}


def _log(path: Path, run: Run, per_epoch: int, figures: dict[str, float]) -> None:
    """Append long-format rows: step, epoch, name, value."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(["step", "epoch", "name", "value"])
        writer.writerows([run.step, round(run.step / per_epoch, 4), name, value] for name, value in figures.items())


def _forget_later_rows(path: Path, step: int) -> None:
    """Drop what a killed run logged after its last checkpoint: those steps are done again."""
    if not path.exists():
        return
    header, *rows = path.read_text().splitlines()
    kept = [row for row in rows if row.count(",") == 3 and int(row.split(",", 1)[0]) <= step]
    path.write_text("\n".join([header, *kept]) + "\n")


def main() -> None:
    """Train from a packed file on a machine that has torch, numpy, h5py and shapely only."""
    import argparse

    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="fast")
    parser.add_argument("--size", choices=["light", "published"], default="light")
    parser.add_argument("--area", type=float, nargs=4, required=True, metavar=("XMIN", "YMIN", "XMAX", "YMAX"))
    parser.add_argument("--epochs", type=float)
    parser.add_argument("--batch", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    changes = {name: value for name, value in (("epochs", a.epochs), ("batch", a.batch)) if value is not None}
    preset = replace(PRESETS[a.preset], seed=a.seed, **changes)
    area = tuple(a.area)
    config = VoxelNetConfig.light(area) if a.size == "light" else VoxelNetConfig(area=area)
    started = time.monotonic()

    def report(step: int, total: int, figures: dict[str, float]) -> None:
        losses = "  ".join(f"{name} {value:.4f}" for name, value in figures.items())
        print(f"{time.monotonic() - started:8.0f} s  step {step}/{total}  {losses}", flush=True)

    train(a.data, config, preset, a.out, device=a.device, workers=a.workers, progress=report)


if __name__ == "__main__":
    main()
