"""`Learning`: settings of a training with PPO."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Learning:
    """Settings of a training with PPO (Schulman et al. 2017). Episodes are short, so without
    discount.

    Attributes:
        envs: Environments that are stepped together.
        rollout: Steps of each environment between updates.
        batch: Size of a minibatch.
        epochs: Passes over the steps of an update.
        learning_rate: Learning rate.
        entropy: Weight of the entropy.
        discount: Discount of rewards.
        width: Width of the two hidden layers, or of `policy_network` if candidates are chosen one
            after another.
        augment: Whether junctions are rotated and mirrored at random in every episode, so that a
            policy for several memorises less of them (only coview's environments).
        checkpoint_s: Seconds between checkpoints.
    """

    envs: int = 16
    rollout: int = 16
    batch: int = 64
    epochs: int = 2
    learning_rate: float = 2e-3
    entropy: float = 0.01
    discount: float = 1.0
    width: int = 32
    augment: bool = False
    checkpoint_s: float = field(default=60.0, repr=False, compare=False)
