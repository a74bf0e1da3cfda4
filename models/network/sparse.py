"""A trained VoxelNet, computed where the points reach: the same maps in a fraction of the time, on CPU and CUDA.

Points touch a few percent of the voxels, and an empty grid's response is a constant of the weights. Voxel features
exist for occupied voxels only; 3D convolutions run on cells that points reach (`sparse_middle`), the light network's
first convolution on occupied columns (`sparse_columns`); BatchNorm is folded, and so are the linear layers before the
published head (`folding`).
"""

from __future__ import annotations

import copy

import torch
from torch import nn

from models.network.folding import FoldedRegionProposal, folded_points
from models.network.sparse_columns import SparseColumns
from models.network.sparse_middle import SparseMiddle
from models.network.voxelnet import HeightFold, Prediction, VoxelNet
from models.network.voxels import Voxels


class SparseVoxelNet(nn.Module):
    """A trained network for inference. Its weights are a folded copy: train the original.

    >>> from models import VoxelNetConfig, voxelise
    >>> config = VoxelNetConfig.light((-8, -8, 8, 8))
    >>> SparseVoxelNet(VoxelNet(config))(voxelise(torch.rand(9, 3), config)).class_logits.shape
    torch.Size([1, 2, 40, 40])
    """

    def __init__(self, network: VoxelNet) -> None:
        super().__init__()
        self.config = network.config
        self.features = copy.deepcopy(network.features)
        self.features.layers = nn.ModuleList(folded_points(layer) for layer in network.features.layers)  # type: ignore[arg-type]
        self.middle: nn.Module
        if isinstance(network.middle, HeightFold):
            self.rpn = FoldedRegionProposal(network.rpn, network.head)
            self.middle = SparseColumns(network.middle, self.rpn.blocks[0][0])
            self.rpn.blocks[0][0] = nn.Identity()
        else:
            self.middle = SparseMiddle(network.middle)
            self.rpn = FoldedRegionProposal(network.rpn, network.head, self.middle.channel_order)
        self.eval().requires_grad_(False)

    @torch.inference_mode()
    def forward(self, voxels: Voxels) -> Prediction:
        """Raw maps of a batch of clouds, as `network.eval()(voxels)` gives them."""
        return self.rpn(self.middle(self.features(voxels), voxels))
