"""Networks that go on as others: of more or fewer classes, or with entries of the configuration changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet


def widened(network: VoxelNet, config: VoxelNetConfig) -> VoxelNet:
    """A network for the classes of `config` that goes on from one for others.

    What both know, the anchors of classes they share included, is taken over; the anchors of new classes begin at
    random, always the same. A network of the same classes without a second stage is given back as it is.
    """
    if network.config.labels == config.labels and not network.config.faces:
        return network
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        bare: dict[str, Any] = {"faces": (), "calibration": (), "rivalry": (), "thresholds": ()}
        wider = VoxelNet(replace(network.config, labels=config.labels, kinds=config.kinds, **bare))
    state = wider.state_dict()
    for name, old in network.state_dict().items():
        if name in state:
            state[name] = _rows_of(state[name], old, wider.config, network.config) if name in _heads() else old
    wider.load_state_dict(state)
    return wider


def rebuilt(network: VoxelNet, **changes: Any) -> VoxelNet:
    """The same weights in a network whose configuration has these changes; what is new in it begins at random."""
    other = VoxelNet(replace(network.config, **changes))
    state = other.state_dict()
    state |= {name: tensor for name, tensor in network.state_dict().items() if name in state}
    other.load_state_dict(state)
    return other.train(network.training)


def _heads() -> set[str]:
    maps = ("classes", "residuals", "direction", "quality")
    return {f"head.{name}.{part}" for name in maps for part in ("weight", "bias")}


def _rows_of(new: Tensor, old: Tensor, wider: VoxelNetConfig, known: VoxelNetConfig) -> Tensor:
    """A tensor of the head: the channels of anchors that both have from the old one, the others as they are."""
    channels = len(new) // len(wider.anchor_labels)
    result = new.clone()
    places = {label: _channels(known, label, channels) for label in known.labels}
    for label in set(wider.labels) & set(known.labels):
        at = _channels(wider, label, channels)
        if len(at) == len(places[label]):
            result[at] = old[places[label]]
    return result


def _channels(config: VoxelNetConfig, label: str, each: int) -> list[int]:
    """The channels of a class's anchors in a map that has so many for each anchor."""
    row = config.labels.index(label)
    anchors = [anchor for anchor, owner in enumerate(config.anchor_labels) if owner == row]
    return [anchor * each + channel for anchor in anchors for channel in range(each)]
