"""VoxelNet (Zhou and Tuzel 2018; paper, section III-D).

    Voxels ─▶ VoxelFeatures ─(v, C)─▶ MiddleLayers | HeightFold ─(B, C, H, W)─▶ RegionProposal ─▶
        Head ─▶ Prediction

B clouds, v occupied voxels, D heights, H cells along x, W cells along y. This is the network as it
is trained; `models.network.sparse` computes the same in less time once it is trained.
"""

import math
from collections import OrderedDict
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from models.config import VoxelNetConfig
from models.network.faces import FaceNetworks
from models.network.grid import Voxels
from toolkit.arrays import Float, Float32, Int64


class Prediction(NamedTuple):
    """Raw maps of the head, A anchors per cell. Channels count anchor by anchor: all of one, then
    the next.
    """

    # background and vehicle (published), or one per label of the anchor
    class_logits: Float[Tensor, "B AC H W"]
    residuals: Float[Tensor, "B AR H W"]  # see `models.network.grid`
    # above 0: faces away from the residuals' heading
    direction_logits: Float[Tensor, "B A H W"] | None = None
    quality_logits: Float[Tensor, "B A H W"] | None = None  # the predicted IoU


class VoxelNet(nn.Module):
    """Network of a configuration."""

    def __init__(self, config: VoxelNetConfig) -> None:
        super().__init__()
        self.config = config
        self.features = VoxelFeatures(config)
        self.middle = MiddleLayers(config) if config.middle_widths else HeightFold(config)
        self.rpn = RegionProposal(config, self.middle.width)
        self.head = Head(config, self.rpn.width)
        # a second stage; it takes no part in `forward`
        self.faces = FaceNetworks() if config.faces else None

    def forward(self, voxels: Voxels) -> Prediction:
        """Raw maps of a batch of clouds."""
        return self.head(self.rpn(self.middle(self.features(voxels), voxels)))


def point_features(voxels: Voxels, config: VoxelNetConfig) -> Float32[Tensor, "n 6"]:
    """Coordinates of points and offsets from voxels' means, m."""
    points = voxels.points
    voxel = voxels.voxel
    total = points.new_zeros(len(voxels.cells), 3, dtype=torch.float64).index_add_(
        0, voxel, points.double()
    )
    mean = (total / torch.bincount(voxel, minlength=len(total))[:, None]).float()
    offset = points - mean[voxel]
    if config.point_features == "published":
        return torch.cat((points, offset), 1)
    size = points.new_tensor([*config.voxel_size[:2], 0.0])
    origin = points.new_tensor([*config.area[:2], config.height[0]])
    centre = origin + (voxels.cells[:, 1:] + 0.5) * size
    return torch.cat((points - centre[voxel], offset), 1)


class VoxelFeatures(nn.Module):
    """Voxel feature encoding: linear maps per point, each followed by the voxel's maximum."""

    def __init__(self, config: VoxelNetConfig) -> None:
        super().__init__()
        self.config = config
        widths = (6, *(2 * width for width in config.vfe_widths))
        sizes = zip(widths, (*config.vfe_widths, config.voxel_width), strict=True)
        self.layers = nn.ModuleList()
        for inputs, outputs in sizes:
            layer = {"linear": nn.Linear(inputs, outputs), "norm": nn.BatchNorm1d(outputs)}
            self.layers.append(nn.Sequential(OrderedDict({**layer, "relu": nn.ReLU()})))

    def forward(self, voxels: Voxels) -> Float[Tensor, "v C"]:
        """Features of the occupied voxels."""
        return self.encode(*self.inputs(voxels), len(voxels.cells))

    def inputs(self, voxels: Voxels) -> tuple[Float32[Tensor, "n 6"], Int64[Tensor, " n"]]:
        """Features of the points, including padding of voxels, and the row of each one's voxel."""
        x = point_features(voxels, self.config)
        voxel = voxels.voxel
        # one zero point represents all that fill a voxel up to T
        if self.config.point_features == "published":
            short = torch.nonzero(
                torch.bincount(voxel, minlength=len(voxels.cells)) < self.config.max_points
            )[:, 0]
            x = torch.cat((x, x.new_zeros(len(short), 6)))
            voxel = torch.cat((voxel, short))
        return x, voxel

    def encode(
        self, x: Float32[Tensor, "n 6"], voxel: Int64[Tensor, " n"], rows: int
    ) -> Float[Tensor, "v C"]:
        """Features of `rows` voxels from their points' features."""
        *encoders, last = self.layers
        for layer in encoders:
            x = layer(x)
            greatest = maximum(x, voxel, rows)
            # indexing would add gradients in any order
            x = torch.cat((x, greatest.index_select(0, voxel)), 1)
        return maximum(last(x), voxel, rows)


def maximum(
    x: Float[Tensor, "n C"], row: Int64[Tensor, " n"], rows: int
) -> Float[Tensor, "rows C"]:
    """Maximum of each row's entries, which are not negative."""
    return x.new_zeros(rows, x.shape[1]).scatter_reduce(0, row[:, None].expand_as(x), x, "amax")


class MiddleLayers(nn.Module):
    """Three 3D convolutions over the dense grid; height becomes channels."""

    def __init__(self, config: VoxelNetConfig) -> None:
        super().__init__()
        self.shape = config.grid_shape
        widths = pairwise((config.voxel_width, *config.middle_widths))
        strides = ((2, 1, 1), (1, 1, 1), (2, 1, 1))
        paddings = ((1, 1, 1), (0, 1, 1), (1, 1, 1))
        self.layers = nn.ModuleList()
        for layer, (inputs, outputs) in enumerate(widths):
            conv = nn.Conv3d(inputs, outputs, 3, strides[layer], paddings[layer])
            self.layers.append(conv_norm_relu(conv))
        depth = (((self.shape[2] + 1) // 2 - 2) + 1) // 2
        if depth < 1:
            problem = f"got {self.shape[2]}: lower voxel_size[2]"
            raise ValueError(f"middle layers need at least 5 voxels of height, {problem}")
        self.width = depth * config.middle_widths[-1]

    def forward(self, features: Float[Tensor, "v C"], voxels: Voxels) -> Float[Tensor, "B K H W"]:
        """Map seen from above."""
        nx, ny, nz = self.shape
        grid = features.new_zeros(voxels.items, nz, nx, ny, features.shape[1])
        item, ix, iy, iz = voxels.cells.unbind(1)
        x = grid.index_put((item, iz, ix, iy), features).permute(0, 4, 1, 2, 3)
        for layer in self.layers:
            x = layer(x)
        return x.flatten(1, 2)


class HeightFold(nn.Module):
    """Light middle: a sum over a column's voxels, with a linear map per height.

    It equals a 1x1 convolution of the grid with its height folded into channels, at the cost of the
    occupied voxels.
    """

    def __init__(self, config: VoxelNetConfig) -> None:
        super().__init__()
        self.shape = config.grid_shape
        self.width = config.column_width
        self.weight = nn.Parameter(torch.empty(self.shape[2], config.voxel_width, self.width))
        # on the meta device it would import torch._dynamo, which takes seconds, and draw nothing
        if not self.weight.is_meta:
            nn.init.normal_(self.weight, std=1 / math.sqrt(config.voxel_width))
        self.norm = nn.BatchNorm1d(self.width)

    def forward(self, features: Float[Tensor, "v C"], voxels: Voxels) -> Float[Tensor, "B K H W"]:
        """Map seen from above."""
        column, key = columns(voxels, self.shape)
        nx, ny = self.shape[:2]
        start = features.new_zeros(len(key), self.width)
        x = torch.relu(
            self.norm(fold_columns(features, voxels.cells[:, 3], column, self.weight, start))
        )
        flat = x.new_zeros(voxels.items * nx * ny, self.width).index_put((key,), x)
        # channels are last in memory
        return flat.view(voxels.items, nx, ny, -1).permute(0, 3, 1, 2)


def fold_columns(
    features: Float[Tensor, "v C"],
    level: Int64[Tensor, " v"],
    column: Int64[Tensor, " v"],
    weight: Float[Tensor, "D C K"],
    start: Float[Tensor, "n K"],
) -> Float[Tensor, "n K"]:
    """Add voxels, times their level's weights, to columns."""
    # several clouds; the voxels of one come level by level
    if bool((level[1:] < level[:-1]).any()):
        by_level = torch.argsort(level, stable=True)
        features = features[by_level]
        column = column[by_level]
    groups = torch.split(features, torch.bincount(level, minlength=len(weight)).tolist())
    products = torch.cat([rows @ weights for rows, weights in zip(groups, weight, strict=True)])
    return start.index_add(0, column, products)


def columns(voxels: Voxels, shape: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Each voxel's occupied column (v,), and each column's place in the flat (B, H, W) map."""
    nx, ny, _ = shape
    item, ix, iy, _ = voxels.cells.unbind(1)
    key = (item * nx + ix) * ny + iy
    occupied = torch.bincount(key, minlength=voxels.items * nx * ny) > 0
    return (torch.cumsum(occupied, 0) - 1)[key], torch.nonzero(occupied)[:, 0]


class RegionProposal(nn.Module):
    """Three blocks, each at half the previous resolution."""

    def __init__(self, config: VoxelNetConfig, inputs: int) -> None:
        super().__init__()
        self.order = config.rpn_layers
        self.add = config.upsample == "add"
        widths = config.rpn_widths
        out = config.upsample_width
        self.blocks = nn.ModuleList()
        for inputs_before, width, order in zip((inputs, *widths), widths, self.order, strict=False):
            layers = [conv_norm_relu(nn.Conv2d(inputs_before, width, 3, 2, 1))]
            layers += [conv_norm_relu(nn.Conv2d(width, width, 3, 1, 1)) for _ in range(max(order))]
            self.blocks.append(nn.ModuleList(layers))
        # kernel, stride, padding of the first block's output
        lateral = (1, 1, 0) if self.add else (3, 1, 1)
        sizes = zip(widths, (lateral, (2, 2, 0), (4, 4, 0)), strict=True)
        self.upsample = nn.ModuleList(
            nn.ConvTranspose2d(width, out, *shape, bias=not self.add) for width, shape in sizes
        )
        if self.add:
            self.norm = nn.BatchNorm2d(out)
        self.width = out if self.add else 3 * out

    def forward(self, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B K h w"]:
        """Feature map of the anchors."""
        maps = []
        for block, order, upsample in zip(self.blocks, self.order, self.upsample, strict=True):
            for layer in order:
                x = block[layer](x)  # type: ignore[index]
            maps.append(upsample(x))
        if self.add:
            return torch.relu(self.norm(maps[0] + maps[1] + maps[2]))
        return torch.cat(maps[::-1], 1)  # published order: the coarsest first


class Head(nn.Module):
    """1x1 convolutions per anchor, after an optional 3x3 one."""

    def __init__(self, config: VoxelNetConfig, inputs: int) -> None:
        super().__init__()
        anchors = len(config.anchor_labels)
        self.conv3x3 = nn.Conv2d(inputs, config.head3x3, 3, padding=1) if config.head3x3 else None
        inputs = config.head3x3 or inputs
        self.classes = nn.Conv2d(inputs, anchors * config.classes, 1)
        self.residuals = nn.Conv2d(inputs, anchors * config.residuals, 1)
        self.direction = self.quality = None
        if config.head == "quality":
            self.direction = nn.Conv2d(inputs, anchors, 1)
            self.quality = nn.Conv2d(inputs, anchors, 1)
            nn.init.constant_(self.classes.bias, -math.log(99))  # type: ignore[arg-type]  # at first, vehicles are rare

    def forward(self, x: Float[Tensor, "B C H W"]) -> Prediction:
        """Raw maps."""
        if self.conv3x3 is not None:
            x = torch.relu(self.conv3x3(x))
        classes = self.classes(x)
        residuals = self.residuals(x)
        direction = None if self.direction is None else self.direction(x)
        quality = None if self.quality is None else self.quality(x)
        return Prediction(classes, residuals, direction, quality)


def conv_norm_relu(conv: nn.Conv2d | nn.Conv3d) -> nn.Sequential:
    """Convolution, BatchNorm and ReLU."""
    norm = nn.BatchNorm3d if isinstance(conv, nn.Conv3d) else nn.BatchNorm2d
    return nn.Sequential(conv, norm(conv.out_channels), nn.ReLU(inplace=True))
