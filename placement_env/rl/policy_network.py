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
        """Make the layers. slots: candidates of an observation; width: units of each layer."""
        super().__init__()
        # Stable-Baselines3 requires these two names: number of actions (each candidate, or to
        # stop), and of value features
        self.latent_dim_pi = slots + 1
        self.latent_dim_vf = width
        # first layer, from the features of one candidate and the global features
        self.of_each = nn.Linear(FEATURES, width)
        self.of_whole = nn.Linear(len(GLOBAL), width, bias=False)
        # second layer, from one candidate's outputs, and from the mean and maximum over all
        self.inner = nn.Linear(width, width)
        self.pooled = nn.Linear(2 * width, width, bias=False)
        # outputs: logits of placing a candidate and of stopping, and features of the value
        self.place = nn.Linear(width, 1)
        self.stop = nn.Linear(width, 1)
        self.value = nn.Linear(width, width)
        for parameter in (*self.place.parameters(), *self.stop.parameters()):
            nn.init.zeros_(parameter)  # at first all actions are equally likely

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (n, slots + 1) and value features (n, width) of observations (n, size).

        A logit is for placing the candidate of each slot, the last one for stopping. An observation
        holds one row of slots for each of `FEATURES` features, then the global features."""
        distinct_rows, row_indices = distinct(observations)  # equal rows are computed once
        flat_features = distinct_rows[:, : -len(GLOBAL)]
        global_features = distinct_rows[:, -len(GLOBAL) :]
        # axes: row, slot, feature
        slot_features = flat_features.reshape(len(distinct_rows), FEATURES, -1).transpose(1, 2)
        hidden = torch.relu(self.of_each(slot_features) + self.of_whole(global_features)[:, None])
        # mean and maximum over the slots describe the junction as a whole
        whole = self.pooled(torch.cat([hidden.mean(1), hidden.max(1).values], 1))
        place_logits = self.place(torch.relu(self.inner(hidden) + whole[:, None]))[..., 0]
        logits = torch.cat([place_logits, self.stop(torch.relu(whole))], 1)
        return logits[row_indices], torch.relu(self.value(whole))[row_indices]

    def forward_actor(self, observations: Tensor) -> Tensor:
        """Logits (n, slots + 1) only."""
        return self(observations)[0]

    def forward_critic(self, observations: Tensor) -> Tensor:
        """Value features (n, width) only."""
        return self(observations)[1]


def distinct(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Distinct rows of an array (n, k), and for each of the n rows its index among them.

    Distinct rows are in the order of their first appearance; indexed by the second result, they are
    all rows again. All episodes of a junction start with the same observation, so many rows are
    equal.
    """
    index_by_bytes: dict[bytes, int] = {}
    indices = [
        # a new row gets the next index
        index_by_bytes.setdefault(row.tobytes(), len(index_by_bytes))
        for row in rows.numpy()
    ]
    # indices count up by first appearance, so in ascending order they keep it
    _, first_rows = np.unique(indices, return_index=True)
    return rows[first_rows], torch.tensor(indices)


class CandidatePolicy(MaskableActorCriticPolicy):
    """sb3-contrib's policy with a `CandidateNetwork`, whose width is the first of `net_arch`."""

    def _build(self, lr_schedule: Schedule) -> None:
        """Make networks and optimiser, as Stable-Baselines3 requires of a policy.

        One action is to stop, and the others place the candidate of a slot."""
        slots = int(self.action_space.n) - 1  # type: ignore[attr-defined]
        self.mlp_extractor = CandidateNetwork(slots, self.net_arch[0])  # type: ignore
        self.action_net = nn.Identity()  # the network gives logits already
        self.value_net = nn.Linear(self.mlp_extractor.latent_dim_vf, 1)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )  # type: ignore
