"""Policy network that judges every candidate with the same weights.

Knowledge of one candidate holds for all others, at any junction and in any order; a plain network
would learn it anew for each slot. It has some thousand weights for any number of slots."""

import numpy as np
import torch
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from placement_env.envs.scenario import STATIC
from placement_env.envs.state import DYNAMIC, GLOBAL

FEATURES = len(STATIC) + len(DYNAMIC)


class CandidateNetwork(nn.Module):
    """Judge candidates by their features, those of the whole, and mean and maximum of the first
    layer's output."""

    def __init__(self, slots: int, width: int) -> None:
        super().__init__()
        # as Stable-Baselines3 asks for
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
        """Return logits (n, slots + 1) and value features (n, width) of observations (n, size)."""
        different, which = distinct(observations)
        of_slots = different[:, : -len(GLOBAL)]
        of_whole = different[:, -len(GLOBAL) :]
        of_slots = of_slots.reshape(len(different), FEATURES, -1).transpose(1, 2)
        each = torch.relu(self.of_each(of_slots) + self.of_whole(of_whole)[:, None])
        pooled = self.pooled(torch.cat([each.mean(1), each.max(1).values], 1))
        place = self.place(torch.relu(self.inner(each) + pooled[:, None]))[..., 0]
        logits = torch.cat([place, self.stop(torch.relu(pooled))], 1)
        return logits[which], torch.relu(self.value(pooled))[which]

    def forward_actor(self, observations: Tensor) -> Tensor:
        """Return the logits alone."""
        return self(observations)[0]

    def forward_critic(self, observations: Tensor) -> Tensor:
        """Return the value features alone."""
        return self(observations)[1]


def distinct(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Distinct rows (n, k) in order, and the number of each row: all episodes of a junction start
    alike."""
    number: dict[bytes, int] = {}
    which = [number.setdefault(row.tobytes(), len(number)) for row in rows.numpy()]
    _, first = np.unique(which, return_index=True)
    return rows[first], torch.tensor(which)


class CandidatePolicy(MaskableActorCriticPolicy):
    """sb3-contrib's policy with a `CandidateNetwork` as wide as `net_arch` begins."""

    def _build(self, lr_schedule: Schedule) -> None:
        self.mlp_extractor = CandidateNetwork(int(self.action_space.n) - 1, self.net_arch[0])  # type: ignore
        self.action_net = nn.Identity()
        self.value_net = nn.Linear(self.mlp_extractor.latent_dim_vf, 1)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )  # type: ignore
