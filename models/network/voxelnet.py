"""VoxelNet (Zhou and Tuzel 2018; paper, section III-D).

    Voxels ─▶ VoxelFeatures ─(voxels, C)─▶ MiddleLayers | HeightFold ─(B, C, H, W)─▶
        RegionProposal ─▶ Head ─▶ Prediction

C channels of B clouds, H cells along x, W cells along y. This is the network as it is trained;
`models.network.sparse` computes the same in less time once it is trained.
"""

import math
from collections import OrderedDict
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from models.config import VoxelNetConfig
from models.network.faces import FaceNetworks
from models.network.grid import Voxels, per_anchor
from toolkit.arrays import Float, Float32, Int64


class AnchorPlaces(NamedTuple):
    """Places of n anchors in the maps of a batch, as indices.

    Attributes:
        item: Cloud or tile in the batch.
        row: Cell along x.
        column: Cell along y.
        anchor: Anchor in the cell.
    """

    item: Int64[Tensor, " n"]
    row: Int64[Tensor, " n"]
    column: Int64[Tensor, " n"]
    anchor: Int64[Tensor, " n"]

    def select(self, rows: Int64[Tensor, " m"]) -> "AnchorPlaces":
        """Places of some of the anchors; rows: their numbers among the n."""
        return AnchorPlaces(*(index[rows] for index in self))


class AnchorOutputs(NamedTuple):
    """Raw outputs of n anchors besides the classes. See `Prediction` for the meaning of each.

    Attributes:
        residuals: residuals of each anchor's box.
        direction_logits: None for a head without them.
        quality_logits: None for a head without them.
    """

    residuals: Float[Tensor, "n residuals"]
    direction_logits: Float[Tensor, " n"] | None = None
    quality_logits: Float[Tensor, " n"] | None = None


class Prediction(NamedTuple):
    """Raw maps of the head, A anchors per cell, H cells along x and W along y.

    Channels count anchor by anchor: all values of one anchor, then of the next.

    Attributes:
        class_logits: Background and vehicle (head "published"), or one per label of the anchor.
        residuals: Residuals of the boxes to their anchors, see `models.network.grid`.
        direction_logits: Above 0: the box faces away from the residuals' heading.
        quality_logits: Predicted IoU of the box.
    """

    class_logits: Float[Tensor, "B AC H W"]
    residuals: Float[Tensor, "B AR H W"]
    direction_logits: Float[Tensor, "B A H W"] | None = None
    quality_logits: Float[Tensor, "B A H W"] | None = None

    def at(self, places: AnchorPlaces, anchors: int) -> AnchorOutputs:
        """Outputs of some anchors. anchors: number A of anchors in a cell."""
        direction = quality = None
        if self.direction_logits is not None:
            direction = per_anchor(self.direction_logits, anchors)[places][:, 0]
        if self.quality_logits is not None:
            quality = per_anchor(self.quality_logits, anchors)[places][:, 0]
        return AnchorOutputs(per_anchor(self.residuals, anchors)[places], direction, quality)


class VoxelNet(nn.Module):
    """Network of a configuration: voxels to the raw maps of the head."""

    def __init__(self, config: VoxelNetConfig) -> None:
        """Make the layers of a configuration, with random weights."""
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
    """Position of each point (x y z, m), then its offset from the mean of its voxel's points (m).

    With "published" features a position is counted from the origin of the grid, otherwise from the
    centre of the voxel's column and the lower end of the height range.
    """
    points = voxels.points
    voxel = voxels.voxel  # number of each point's voxel
    offset = points - voxel_means(points, voxel, len(voxels.cells))[voxel]
    if config.point_features == "published":
        return torch.cat((points, offset), 1)
    return torch.cat((points - voxel_references(voxels.cells, config)[voxel], offset), 1)


def voxel_means(
    points: Float32[Tensor, "n 3"], voxel: Int64[Tensor, " n"], count: int
) -> Float32[Tensor, "voxels 3"]:
    """Mean of the points in each of `count` voxels. voxel: number of each point's voxel."""
    # in float64, so that the order of the points does not matter
    total = points.new_zeros(count, 3, dtype=torch.float64).index_add_(0, voxel, points.double())
    return (total / torch.bincount(voxel, minlength=count)[:, None]).float()


def voxel_references(
    cells: Int64[Tensor, "voxels 4"], config: VoxelNetConfig
) -> Float32[Tensor, "voxels 3"]:
    """Point (x y z, m) from which a voxel's points are counted with "local" features.

    It is the centre of the voxel's column, at the lower end of the height range. cells: cloud, x, y
    and z index of each voxel.
    """
    # z = 0: heights are not divided
    size = torch.tensor([*config.voxel_size[:2], 0.0], device=cells.device)
    origin = torch.tensor([*config.area[:2], config.height[0]], device=cells.device)
    return origin + (cells[:, 1:] + 0.5) * size


class VoxelFeatures(nn.Module):
    """Voxel feature encoding: linear maps per point, each followed by the voxel's maximum."""

    def __init__(self, config: VoxelNetConfig) -> None:
        """Make the linear maps of a configuration, with random weights."""
        super().__init__()
        self.config = config
        # a point has six features; a layer's outputs are joined by the voxel's maxima, so the next
        # one has twice the inputs
        input_widths = (6, *(2 * width for width in config.vfe_widths))
        output_widths = (*config.vfe_widths, config.voxel_width)
        self.layers = nn.ModuleList()
        for inputs, outputs in zip(input_widths, output_widths, strict=True):
            layer = OrderedDict[str, nn.Module](
                linear=nn.Linear(inputs, outputs), norm=nn.BatchNorm1d(outputs), relu=nn.ReLU()
            )
            self.layers.append(nn.Sequential(layer))

    def forward(self, voxels: Voxels) -> Float[Tensor, "voxels C"]:
        """Features of the occupied voxels."""
        return self.encode(*self.inputs(voxels), len(voxels.cells))

    def inputs(self, voxels: Voxels) -> tuple[Float32[Tensor, "n 6"], Int64[Tensor, " n"]]:
        """Features of the points, then of padding points, and the row of each one's voxel.

        Published networks pad voxels with less than T points; a single point of zeros has the same
        effect, since only maxima count.
        """
        x = point_features(voxels, self.config)
        voxel = voxels.voxel
        if self.config.point_features == "published":
            counts = torch.bincount(voxel, minlength=len(voxels.cells))
            padded_voxels = torch.nonzero(counts < self.config.max_points)[:, 0]
            x = torch.cat((x, x.new_zeros(len(padded_voxels), 6)))
            voxel = torch.cat((voxel, padded_voxels))
        return x, voxel

    def encode(
        self, x: Float32[Tensor, "n 6"], voxel: Int64[Tensor, " n"], rows: int
    ) -> Float[Tensor, "voxels C"]:
        """Features of `rows` voxels.

        x: features of points. voxel: row of each point's voxel.
        """
        *encoders, last = self.layers
        for layer in encoders:
            x = layer(x)
            greatest = maximum(x, voxel, rows)
            # `greatest[voxel]` would add gradients in any order, this does not
            x = torch.cat((x, greatest.index_select(0, voxel)), 1)
        return maximum(last(x), voxel, rows)


def maximum(
    x: Float[Tensor, "n C"], row: Int64[Tensor, " n"], rows: int
) -> Float[Tensor, "rows C"]:
    """Maximum over the entries of each row and channel, 0 for a row without entries.

    x: entries, not negative. row: row of each entry.
    """
    return x.new_zeros(rows, x.shape[1]).scatter_reduce(0, row[:, None].expand_as(x), x, "amax")


class MiddleLayers(nn.Module):
    """Three 3D convolutions over the dense grid; height becomes channels."""

    def __init__(self, config: VoxelNetConfig) -> None:
        """Make the three convolutions of a configuration, with random weights."""
        super().__init__()
        # voxels along x, y and z
        self.shape = config.grid_shape
        # inputs, outputs
        widths = pairwise((config.voxel_width, *config.middle_widths))
        # for the three layers, along z, x and y
        strides = ((2, 1, 1), (1, 1, 1), (2, 1, 1))
        paddings = ((1, 1, 1), (0, 1, 1), (1, 1, 1))
        self.layers = nn.ModuleList()
        for layer, (inputs, outputs) in enumerate(widths):
            conv = nn.Conv3d(inputs, outputs, 3, strides[layer], paddings[layer])
            self.layers.append(conv_norm_relu(conv))
        depth = (((self.shape[2] + 1) // 2 - 2) + 1) // 2  # levels after the three strides
        if depth < 1:
            problem = f"got {self.shape[2]}: lower voxel_size[2]"
            raise ValueError(f"middle layers need at least 5 voxels of height, {problem}")
        self.width = depth * config.middle_widths[-1]

    def forward(
        self, features: Float[Tensor, "voxels C"], voxels: Voxels
    ) -> Float[Tensor, "B outputs H W"]:
        """Map seen from above, with the levels of height as channels.

        features: a row for each occupied voxel.
        """
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
        """Make a linear map for each level of height, with random weights."""
        super().__init__()
        self.shape = config.grid_shape
        self.width = config.column_width
        self.weight = nn.Parameter(torch.empty(self.shape[2], config.voxel_width, self.width))
        # on the meta device it would import torch._dynamo, which takes seconds, to set nothing
        if not self.weight.is_meta:
            nn.init.normal_(self.weight, std=1 / math.sqrt(config.voxel_width))
        self.norm = nn.BatchNorm1d(self.width)

    def forward(
        self, features: Float[Tensor, "voxels C"], voxels: Voxels
    ) -> Float[Tensor, "B outputs H W"]:
        """Map seen from above, 0 in cells without points; channels are last in memory.

        features: a row for each occupied voxel.
        """
        column, cell = columns(voxels, self.shape)
        nx, ny = self.shape[:2]
        sums = fold_columns(
            features,
            level=voxels.cells[:, 3],
            column=column,
            weight=self.weight,
            start=features.new_zeros(len(cell), self.width),
        )
        x = torch.relu(self.norm(sums))
        cells = x.new_zeros(voxels.items * nx * ny, self.width).index_put((cell,), x)
        return cells.view(voxels.items, nx, ny, -1).permute(0, 3, 1, 2)


def fold_columns(
    features: Float[Tensor, "voxels C"],
    level: Int64[Tensor, " voxels"],
    column: Int64[Tensor, " voxels"],
    weight: Float[Tensor, "levels C outputs"],
    start: Float[Tensor, "n outputs"],
) -> Float[Tensor, "n outputs"]:
    """Columns, each with its voxels' features times the weights of their levels added.

    level: index along z of each voxel. column: row in `start` of each voxel's column. weight: one
    matrix for each level. start: values of the n columns before.
    """
    # the voxels of one cloud come level by level; if there are several clouds, they must be sorted
    if bool((level[1:] < level[:-1]).any()):
        by_level = torch.argsort(level, stable=True)
        features = features[by_level]
        column = column[by_level]
    groups = torch.split(features, torch.bincount(level, minlength=len(weight)).tolist())
    products = torch.cat([rows @ weights for rows, weights in zip(groups, weight, strict=True)])
    return start.index_add(0, column, products)


def columns(voxels: Voxels, shape: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Number of each voxel's column among the n occupied ones (v,), and the cell of each occupied
    column (n,), counted in the flat (B, H, W) map.

    shape: voxels along x, y and z.
    """
    nx, ny, _ = shape
    item, ix, iy, _ = voxels.cells.unbind(1)
    cell = (item * nx + ix) * ny + iy
    # an occupied cell's number is how many occupied ones come before it
    is_occupied = torch.bincount(cell, minlength=voxels.items * nx * ny) > 0
    return (torch.cumsum(is_occupied, 0) - 1)[cell], torch.nonzero(is_occupied)[:, 0]


class RegionProposal(nn.Module):
    """Three blocks, each at half the previous resolution.

    order: for each block, the indices of its layers in the order of their use; a layer may be used
    more than once. add: True if the three maps are added, False if they are joined as channels.
    """

    def __init__(self, config: VoxelNetConfig, inputs: int) -> None:
        """Make the three blocks and the join of their maps. inputs: channels of the input."""
        super().__init__()
        # for each block the indices of its layers as they run, perhaps one twice; 0 has stride 2
        self.order = config.rpn_layers
        self.add = config.upsample == "add"
        widths = config.rpn_widths
        map_width = config.upsample_width
        self.blocks = nn.ModuleList()
        # a block takes what the one before gives; the last width is the input of no block
        for block_inputs, width, order in zip((inputs, *widths), widths, self.order, strict=False):
            layers = [conv_norm_relu(nn.Conv2d(block_inputs, width, 3, stride=2, padding=1))]
            for _ in range(max(order)):  # the indices go from 0 to the largest
                layers.append(conv_norm_relu(nn.Conv2d(width, width, 3, stride=1, padding=1)))
            self.blocks.append(nn.ModuleList(layers))
        # kernel, stride and padding for the map of each block
        first_shape = (1, 1, 0) if self.add else (3, 1, 1)
        shapes = (first_shape, (2, 2, 0), (4, 4, 0))
        self.upsample = nn.ModuleList(
            nn.ConvTranspose2d(width, map_width, *shape, bias=not self.add)
            for width, shape in zip(widths, shapes, strict=True)
        )
        if self.add:
            self.norm = nn.BatchNorm2d(map_width)
        self.width = map_width if self.add else 3 * map_width

    def forward(self, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B outputs h w"]:
        """Feature map for the head, at the resolution of the first block.

        x: map of the grid seen from above, H along its x axis and W along its y axis."""
        # a map for each block, the finest first, all brought to one resolution
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
        """Make a convolution for each map. inputs: channels of the input."""
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
            # a probability of 1 % at first, 1 / (1 + 99), since vehicles are rare
            nn.init.constant_(self.classes.bias, -math.log(99))  # type: ignore[arg-type]

    def forward(self, x: Float[Tensor, "B C H W"]) -> Prediction:
        """Raw maps: class logits, residuals and, with these heads, direction and quality logits."""
        if self.conv3x3 is not None:
            x = torch.relu(self.conv3x3(x))
        return Prediction(
            class_logits=self.classes(x),
            residuals=self.residuals(x),
            direction_logits=None if self.direction is None else self.direction(x),
            quality_logits=None if self.quality is None else self.quality(x),
        )


def conv_norm_relu(conv: nn.Conv2d | nn.Conv3d) -> nn.Sequential:
    """Convolution, BatchNorm and ReLU."""
    norm = nn.BatchNorm3d if isinstance(conv, nn.Conv3d) else nn.BatchNorm2d
    return nn.Sequential(conv, norm(conv.out_channels), nn.ReLU(inplace=True))
