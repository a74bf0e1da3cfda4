"""Policy network that judges every candidate with the same weights.

Knowledge of one candidate holds for all others, at any junction and in any order; a plain network
would have to learn it for each slot. It has some thousand weights for any number of slots.
"""

import numpy as np
import torch
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from placement_env.envs.scenario import STATIC
from placement_env.envs.state import DYNAMIC, GLOBAL

FEATURES = len(STATIC) + len(DYNAMIC)


class CandidateNetwork(nn.Module):
    """Judge candidates by their features, the global features, and pooled outputs of a first layer.

    The first layer treats each candidate separately; its outputs are pooled over all candidates by
    mean and maximum. slots: number of candidates of an observation, so actions are to place one of
    them or to stop; width: units of each layer.
    """

    def __init__(self, slots: int, width: int) -> None:
        super().__init__()
        # names that Stable-Baselines3 requires
        self.latent_dim_pi = slots + 1
        self.latent_dim_vf = width
        self.of_each = nn.Linear(FEATURES, width)
        self.of_whole = nn.Linear(len(GLOBAL), width, bias=False)
        self.inner = nn.Linear(width, width)
        self.pooled = nn.Linear(2 * width, width, bias=False)
        self.place = nn.Linear(width, 1)
        self.stop = nn.Linear(width, 1)
        self.value = nn.Linear(width, width)
        for parameter in (*self.place.parameters(), *self.stop.parameters()):
            nn.init.zeros_(parameter)  # at first all actions are equally likely

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (n, slots + 1) and value features (n, width) of observations (n, size).

        The last logit is for stopping. An observation holds one row of slots for each of `FEATURES`
        features, then the global features."""
        distinct_rows, row_numbers = distinct(observations)
        slot_features = distinct_rows[:, : -len(GLOBAL)]
        global_features = distinct_rows[:, -len(GLOBAL) :]
        # axes: row, slot, feature
        slot_features = slot_features.reshape(len(distinct_rows), FEATURES, -1).transpose(1, 2)
        hidden = torch.relu(self.of_each(slot_features) + self.of_whole(global_features)[:, None])
        pooled = self.pooled(torch.cat([hidden.mean(1), hidden.max(1).values], 1))
        placing = self.place(torch.relu(self.inner(hidden) + pooled[:, None]))[..., 0]
        logits = torch.cat([placing, self.stop(torch.relu(pooled))], 1)
        return logits[row_numbers], torch.relu(self.value(pooled))[row_numbers]

    def forward_actor(self, observations: Tensor) -> Tensor:
        """Logits (n, slots + 1) only."""
        return self(observations)[0]

    def forward_critic(self, observations: Tensor) -> Tensor:
        """Value features (n, width) only."""
        return self(observations)[1]


def distinct(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Distinct rows of (n, k) in the order of their first appearance, and the index of each row.

    All episodes of a junction start with the same observation, so many rows are equal and are
    computed once: `distinct_rows[indices]` are the rows again.
    """
    row_of_bytes: dict[bytes, int] = {}
    numbers = [row_of_bytes.setdefault(row.tobytes(), len(row_of_bytes)) for row in rows.numpy()]
    _, first_rows = np.unique(numbers, return_index=True)
    return rows[first_rows], torch.tensor(numbers)


class CandidatePolicy(MaskableActorCriticPolicy):
    """sb3-contrib's policy with a `CandidateNetwork`, whose width is the first of `net_arch`."""

    def _build(self, lr_schedule: Schedule) -> None:
        self.mlp_extractor = CandidateNetwork(int(self.action_space.n) - 1, self.net_arch[0])  # type: ignore
        self.action_net = nn.Identity()
        self.value_net = nn.Linear(self.mlp_extractor.latent_dim_vf, 1)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )  # type: ignore
