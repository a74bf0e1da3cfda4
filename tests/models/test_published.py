"""`load_published` against the formats document, followed line by line by a slow dense network written here."""

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from models.published import load_published

REFERENCE = {"tjunction": (84, 0, 156), "roundabout": (0, 0, 0)}  # x, up, y of CARLA
EXTENTS = {"tjunction": ((0, 40), (0, 4), (0, 80)), "roundabout": ((-48, 48), (0, 4), (-48, 48))}
VOXEL = {"tjunction": (0.2, 0.4, 0.2), "roundabout": (0.4, 0.4, 0.4)}


class PublishedNetwork(nn.Module):
    """The layer table of the document, dense. Its state dict has the documented names."""

    def __init__(self):
        super().__init__()
        self.feature_learnig = nn.Module()
        self.feature_learnig.vfe1 = nn.Module()
        self.feature_learnig.vfe1.fcn1 = _layer(nn.Conv2d(6, 16, 1))
        self.feature_learnig.fcn1 = _layer(nn.Conv2d(32, 128, 1))
        self.conv3d = nn.Module()
        self.conv3d.conv1 = _layer(nn.Conv3d(128, 64, 3, (2, 1, 1), 1))
        self.conv3d.conv2 = _layer(nn.Conv3d(64, 64, 3, 1, (0, 1, 1)))
        self.conv3d.conv3 = _layer(nn.Conv3d(64, 64, 3, (2, 1, 1), 1))
        self._rpn = nn.Module()
        for block, count, before, width in ((1, 4, 128, 128), (2, 5, 128, 128), (3, 5, 128, 256)):
            for k in range(1, count + 1):
                conv = nn.Conv2d(before if k == 1 else width, width, 3, 2 if k == 1 else 1, 1)
                setattr(self._rpn, f"conv{block}_{k}", _layer(conv))
        self._rpn.deconv1 = nn.ConvTranspose2d(256, 256, 4, 4)
        self._rpn.deconv2 = nn.ConvTranspose2d(128, 256, 2, 2)
        self._rpn.deconv3 = nn.ConvTranspose2d(128, 256, 3, 1, 1)
        self._rpn.rpn_head = nn.Module()
        self._rpn.rpn_head.conv3x3 = nn.Conv2d(768, 512, 3, 1, 1)
        self._rpn.rpn_head.conv_cls = nn.Conv2d(512, 4, 1)
        self._rpn.rpn_head.conv_loc = nn.Conv2d(512, 14, 1)

    def forward(self, padded, cells, shape):
        """padded (V, 35, 6); cells (V, 3) along x, up, z; shape of the grid along x, up, z."""
        x = padded.permute(2, 0, 1)[None]
        x = _apply(self.feature_learnig.vfe1.fcn1, x)
        x = torch.cat((x, x.amax(3, keepdim=True).expand_as(x)), 1)
        x = _apply(self.feature_learnig.fcn1, x).amax(3)[0].T
        grid = torch.zeros(1, *shape, 128)
        grid[0, cells[:, 0], cells[:, 1], cells[:, 2]] = x
        x = grid.permute(0, 4, 2, 1, 3)
        for k in (1, 2, 3):
            x = _apply(getattr(self.conv3d, f"conv{k}"), x)
        x = x.reshape(1, 128, shape[0], shape[2])
        for name in ("1_1", "1_2", "1_3", "1_4"):
            x = _apply(getattr(self._rpn, f"conv{name}"), x)
        fine = x
        for name in ("2_1", "2_2", "2_2", "2_3", "2_4", "2_5"):
            x = _apply(getattr(self._rpn, f"conv{name}"), x)
        middle = x
        for name in ("3_1", "3_2", "3_3", "3_3", "3_4", "3_5"):
            x = _apply(getattr(self._rpn, f"conv{name}"), x)
        x = torch.cat((self._rpn.deconv1(x), self._rpn.deconv2(middle), self._rpn.deconv3(fine)), 1)
        x = F.relu(self._rpn.rpn_head.conv3x3(x))
        return self._rpn.rpn_head.conv_cls(x), self._rpn.rpn_head.conv_loc(x)


def _layer(conv):
    layer = nn.Module()
    layer.conv1 = conv
    layer.bn1 = (nn.BatchNorm3d if isinstance(conv, nn.Conv3d) else nn.BatchNorm2d)(conv.out_channels)
    return layer


def _apply(layer, x):
    return F.relu(layer.bn1(layer.conv1(x)))


def random_network(seed=0):
    """Weights that keep the scale of what passes, and running statistics and affine maps that are not the identity."""
    torch.manual_seed(seed)
    network = PublishedNetwork()
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            nn.init.uniform_(module.bias, -0.1, 0.1)
        elif isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            nn.init.uniform_(module.weight, 0.6, 1.2)
            nn.init.uniform_(module.bias, -0.2, 0.2)
            nn.init.uniform_(module.running_mean, -0.3, 0.3)
            nn.init.uniform_(module.running_var, 0.5, 2)
    with torch.no_grad():
        network.feature_learnig.vfe1.fcn1.conv1.weight[:, :3] *= 0.05  # coordinates go up to 80 m
    return network.eval()


def padded_voxels(points, site):
    """Right-handed CARLA points -> their (V, 35, 6) input, cells along x, up, z, and grid shape."""
    swapped = points[:, [0, 2, 1]] * np.float32([1, 1, -1]) - np.float32(REFERENCE[site])
    lower, upper = np.float32(EXTENTS[site]).T
    kept = swapped[((swapped > lower) & (swapped < upper)).all(1)]
    first = np.floor(lower / VOXEL[site])
    shape = (np.ceil(upper / VOXEL[site]) - 1 - first + 1).astype(int)
    members = {}
    for point, cell in zip(kept, np.floor(kept / VOXEL[site]) - first, strict=True):
        members.setdefault(tuple(cell.astype(int)), []).append(point)
    padded = np.zeros((len(members), 35, 6), np.float32)
    for row, inside in enumerate(members.values()):
        inside = np.array(inside[:35])
        padded[row, : len(inside), :3] = inside
        padded[row, : len(inside), 3:] = inside - inside.mean(axis=0)
    return torch.from_numpy(padded), torch.tensor(list(members)).reshape(-1, 3), tuple(shape.tolist())


def checkpoint(path, state_dict):
    torch.save({"epoch": 30, "state_dict": state_dict, "best_recall": 0.9, "optimizer": {"state": {}}}, path)
    return path


def cloud(site, n=3000, seed=1):
    """Random points in and around the area, right-handed CARLA coordinates; fewer than 35 in any voxel."""
    rng = np.random.default_rng(seed)
    (x0, x1), _, (z0, z1) = EXTENTS[site]
    x_ref, _, z_ref = REFERENCE[site]
    points = rng.uniform((x0 - 2, z0 - 2, -0.5), (x1 + 2, z1 + 2, 4.5), (n, 3))
    points[: n // 2, :2] = points[: n // 2, :2] * 0.1 + np.array([(x0 + x1) / 2, (z0 + z1) / 2])
    points[: n // 2, 2] *= 0.3
    return (np.stack((points[:, 0] + x_ref, -points[:, 1] - z_ref, points[:, 2]), 1)).astype(np.float32)


def to_site(points, site):
    if site == "roundabout":
        return points
    return np.stack((196 + points[:, 1], 104 - points[:, 0], points[:, 2]), 1).astype(np.float32)


@pytest.fixture(scope="module")
def network():
    return random_network()


@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_raw_maps_are_those_of_the_documented_network(site, network, tmp_path):
    detector = load_published(checkpoint(tmp_path / "checkpoint_e30.pth", network.state_dict()), site)
    points = cloud(site)
    with torch.inference_mode():
        classes, residuals = network(*padded_voxels(points, site))
    ours = detector.head(points, frame="carla")
    assert [tuple(each.shape) for each in ours] == [(1, 4, *classes.shape[2:]), (1, 14, *classes.shape[2:])]
    assert classes.abs().max() > 0.1  # the weights keep the signal alive
    torch.testing.assert_close(ours[0], classes, atol=1e-4, rtol=0)
    torch.testing.assert_close(ours[1], residuals, atol=1e-4, rtol=0)
    in_site_frame = detector.head(to_site(points, site))
    assert float((in_site_frame[1] - residuals).abs().quantile(0.99)) < 0.02 * float(residuals.std())
