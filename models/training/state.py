"""`TrainingState`: everything that a training resumes from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.optim.lr_scheduler import LRScheduler, MultiStepLR, OneCycleLR

from models.config import VoxelNetConfig
from models.network.voxelnet import Prediction, VoxelNet
from models.training.preset import Preset
from models.training.samples import Batch

MAX_GRADIENT_NORM = 10.0
Loss = Callable[[Prediction, Tensor, Tensor, Tensor], dict[str, Tensor]]


@dataclass
class TrainingState:
    """Training in progress: exactly a checkpoint's content.

    Attributes:
        network: Network in training.
        optimiser: Optimiser of its weights.
        scheduler: Schedule of the learning rate.
        step: Number of finished steps.
        spent: Seconds of training so far.
        recent: Losses, by name, of each step since the last row of the log.
    """

    network: VoxelNet
    optimiser: torch.optim.Optimizer
    scheduler: LRScheduler
    step: int = 0
    spent: float = 0.0
    recent: list[dict[str, float]] = field(default_factory=list)

    def state(self) -> dict[str, object]:
        """Return the state as tensors and numbers by name, as a checkpoint keeps it.

        "spent" is the time of the training so far (s), "recent" the losses by name of each step
        since the last row of the log, "rng" the state of PyTorch's random numbers."""
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
        """Resume from the saved state of a run of `total` steps.

        Raises ValueError for a step outside the run. Checkpoints of older versions lack the time
        spent and the recent losses."""
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

    def learn(
        self, batch: Batch, loss_of: Loss, anchor: Tensor, *, bfloat16: bool
    ) -> dict[str, float]:
        """Change the weights by one batch, and return its losses, by name.

        anchor: (rows, columns, anchors of a cell, 7) boxes; bfloat16: True to compute the network
        in this shorter format."""
        with torch.autocast(anchor.device.type, torch.bfloat16, enabled=bfloat16):
            prediction = self.network(batch.voxels)
        maps = [None if raw_map is None else raw_map.float() for raw_map in prediction]
        losses = loss_of(Prediction(*maps), batch.labels, batch.boxes, anchor)  # type: ignore[arg-type]
        loss = torch.stack(list(losses.values())).sum()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), MAX_GRADIENT_NORM)
        self.optimiser.step()
        values = torch.stack(list(losses.values())).tolist()
        return dict(zip(losses, values, strict=True))


def start_training(
    config: VoxelNetConfig, preset: Preset, total: int, per_epoch: int, device: str
) -> TrainingState:
    """Start a training of `total` steps with random weights.

    preset: seed, optimiser and schedule of the learning rate; per_epoch: steps of an epoch."""
    torch.manual_seed(preset.seed)
    network = VoxelNet(config).to(device)
    # a network without three-dimensional layers trains with its channels last in memory
    if not config.middle_widths:
        network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    parameters = network.train().parameters()
    rate = preset.learning_rate
    decay = preset.weight_decay
    optimiser: torch.optim.Optimizer
    if preset.optimiser == "sgd":
        optimiser = torch.optim.SGD(parameters, rate, momentum=0.9, weight_decay=decay)
    else:
        optimiser = torch.optim.AdamW(parameters, rate, weight_decay=decay)
    schedule: LRScheduler
    if preset.schedule == "step":
        # a tenth of the rate after ten epochs
        schedule = MultiStepLR(optimiser, [10 * per_epoch], gamma=0.1)
    else:
        # rises to the rate in the first fifth of the steps; it needs a few steps to have a shape
        schedule = OneCycleLR(optimiser, rate, total_steps=max(total, 10), pct_start=0.2)
    return TrainingState(network, optimiser, schedule)
