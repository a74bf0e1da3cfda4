"""A network that predicts from the map alone what sets of candidates are worth, and so which sensor to place next.

All candidates and all cells are judged with the same few weights, so what is learned holds for any site, any number of
candidates and any order of them. A cell q of the raster has a weight w_q, the share of vehicles expected there; a
candidate c has the evidence z_cq of a vehicle there, of what its outlook says of the cell (`Outlook.view`) and what the
map does. The evidence of a set adds up, and AP grows with the vehicles that are likely to be hit,

    S_q = Σ_c exp z_cq         hit_q = Σ_k share_k · sigmoid(slope_k · log S_q + offset_k)         V = Σ_q w_q · hit_q
    AP = V · (1 - κ (1 - V))

so that a candidate which sees what the chosen ones see already adds little. What a candidate sends is predicted from
its features; how sure that is says how likely its link carries it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from placement_env.candidates.outlook.ground_plan import CHANNELS
from placement_env.candidates.outlook.outlook import CANDIDATE_FEATURES, VIEW

NETWORK_WIDTH = 24
VEHICLE_KINDS = 3  # of vehicles in a cell: those that little evidence is enough for, and others
TRAFFIC_CHANNEL = CHANNELS.index("traffic")
SENDERS = ("height", "tilt", "field of view", "rays", "ground rays", "solid rays")
SENDING = [CANDIDATE_FEATURES.index(name) for name in SENDERS]
LEAST_EVIDENCE = 1e-6


class Prospects(NamedTuple):
    """What the network makes of a map once for all sets: evidence exp z of each candidate and cell, weight of each
    cell, log kbit of each candidate, and log of its standard deviation."""

    evidence: Tensor
    weight: Tensor
    log_kbit: Tensor
    log_spread: Tensor


class MapNetwork(nn.Module):
    """The network above. Its inputs are those of an `Outlook`: channels (Q, 8) of the used cells, view (C, Q, 5),
    features (C, 10)."""

    def __init__(self, width: int = NETWORK_WIDTH) -> None:
        super().__init__()
        self.width = width
        self.of_view = nn.Linear(len(VIEW), width)
        self.of_cell = nn.Linear(len(CHANNELS), width, bias=False)
        self.inner, self.out = nn.Linear(width, width), nn.Linear(width, 1)
        of_crowd = nn.Linear(width, 1)
        self.crowd = nn.Sequential(nn.Linear(len(CHANNELS), width), nn.SiLU(), of_crowd)
        self.sending = nn.Sequential(nn.Linear(len(SENDING), width), nn.SiLU(), nn.Linear(width, 2))
        self.share, self.false_alarms = nn.Parameter(torch.zeros(VEHICLE_KINDS)), nn.Parameter(torch.tensor(-2.0))
        self.slope, self.offset = (
            nn.Parameter(torch.zeros(VEHICLE_KINDS)),
            nn.Parameter(torch.linspace(-3.0, 3.0, VEHICLE_KINDS)),
        )
        nn.init.zeros_(of_crowd.weight)  # at first as many vehicles as the map says
        nn.init.zeros_(of_crowd.bias)

    def prospects(self, channels: Tensor, view: Tensor, features: Tensor) -> Prospects:
        """What there is to be known of the candidates before any is chosen."""
        first = torch.relu(self.of_view(view) + self.of_cell(channels))
        logit = self.out(torch.relu(self.inner(first)))[..., 0]
        crowd = torch.log(
            channels[:, TRAFFIC_CHANNEL] / (1 - channels[:, TRAFFIC_CHANNEL] + LEAST_EVIDENCE) + LEAST_EVIDENCE
        )
        weight = torch.softmax(crowd + self.crowd(channels)[:, 0], 0)
        log_kbit, log_spread = self.sending(features[:, SENDING]).unbind(1)
        return Prospects(torch.exp(logit.clamp(-20, 20)), weight, 6 + log_kbit, log_spread.clamp(-3, 2))

    def hit(self, evidence: Tensor) -> Tensor:
        """Probability that a vehicle is hit, by the evidence of it (any shape)."""
        level = torch.log(evidence + LEAST_EVIDENCE)
        shares = torch.softmax(self.share, 0)
        each = [
            shares[k] * torch.sigmoid(torch.exp(self.slope[k]) * level + self.offset[k]) for k in range(VEHICLE_KINDS)
        ]
        return torch.stack(each).sum(0)

    def ap(self, evidence: Tensor, weight: Tensor) -> Tensor:
        """AP (...) of sets by the evidence (..., Q) of each cell."""
        value = self.hit(evidence) @ weight
        return value * (1 - torch.sigmoid(self.false_alarms) * (1 - value))

    def next_ap(self, prospects: Prospects, chosen: Tensor) -> Tensor:
        """AP (n, C) of sets, given as rows (n, C) of 0 and 1, with each candidate beside them."""
        together = chosen @ prospects.evidence
        return self.ap(together[:, None] + prospects.evidence, prospects.weight)
