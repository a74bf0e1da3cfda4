"""`Preset`: settings of a training, apart from network and data."""

from dataclasses import dataclass, field
from typing import Literal

from models.config import VoxelNetConfig
from models.training.samples import SampleRecipe


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


def check_fit(config: VoxelNetConfig, preset: Preset) -> None:
    """Raise ValueError if a preset cannot train a network of a configuration."""
    if config.head != preset.loss:
        raise ValueError(
            f"the {preset.loss} loss needs a network with that head, got head {config.head!r}"
        )
    if len(config.labels) > 1 and not config.kinds:
        raise ValueError(
            f"several labels need an anchor kind each, got {config.labels}: give kinds"
        )
    if preset.batch < 1 or not preset.epochs > 0:
        raise ValueError(
            f"need a batch of at least 1 and epochs above 0, got {preset.batch} and {preset.epochs}"
        )
    # a window is a part of a frame; each frame read gives so many examples
    if preset.batch % preset.examples.windows:
        raise ValueError(
            f"windows must divide the batch, got {preset.examples.windows} for {preset.batch} "
            "examples"
        )
