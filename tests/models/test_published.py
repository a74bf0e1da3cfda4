"""`load_published` against the formats document, followed line by line by a slow dense network
written here."""

import os
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from models import config, published
from models.network.voxelnet import VoxelNet
from models.published import load_published

REFERENCE = {"tjunction": (84, 0, 156), "roundabout": (0, 0, 0)}  # x, up, y of CARLA
EXTENTS = {"tjunction": ((0, 40), (0, 4), (0, 80)), "roundabout": ((-48, 48), (0, 4), (-48, 48))}
VOXEL = {"tjunction": (0.2, 0.4, 0.2), "roundabout": (0.4, 0.4, 0.4)}


class PublishedNetwork(nn.Module):
    """The layer table of the document, dense. Its state dict has the documented names."""

    feature_learnig: Any
    conv3d: Any
    _rpn: Any

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
        grid = torch.zeros(1, *shape, 128)
        if len(padded):
            x = padded.permute(2, 0, 1)[None]
            x = _apply(self.feature_learnig.vfe1.fcn1, x)
            x = torch.cat((x, x.amax(3, keepdim=True).expand_as(x)), 1)
            x = _apply(self.feature_learnig.fcn1, x).amax(3)[0].T
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
    layer.bn1 = (nn.BatchNorm3d if isinstance(conv, nn.Conv3d) else nn.BatchNorm2d)(
        conv.out_channels
    )
    return layer


def _apply(layer, x):
    return F.relu(layer.bn1(layer.conv1(x)))


def random_network(seed=0):
    """Weights that keep the scale of what passes, and running statistics and affine maps that are
    not the identity."""
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
    lower, upper = np.array(EXTENTS[site], np.float32).T
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
    return (
        torch.from_numpy(padded),
        torch.tensor(list(members)).reshape(-1, 3),
        tuple(shape.tolist()),
    )


def checkpoint(path, state_dict):
    torch.save(
        {"epoch": 30, "state_dict": state_dict, "best_recall": 0.9, "optimizer": {"state": {}}},
        path,
    )
    return path


def cloud(site, n=3000, seed=1):
    """Random points in and around the area, right-handed CARLA coordinates; fewer than 35 in any
    voxel."""
    rng = np.random.default_rng(seed)
    (x0, x1), _, (z0, z1) = EXTENTS[site]
    x_ref, _, z_ref = REFERENCE[site]
    points = rng.uniform((x0 - 2, z0 - 2, -0.5), (x1 + 2, z1 + 2, 4.5), (n, 3))
    points[: n // 2, :2] = points[: n // 2, :2] * 0.1 + np.array([(x0 + x1) / 2, (z0 + z1) / 2])
    points[: n // 2, 2] *= 0.3
    return (np.stack((points[:, 0] + x_ref, -points[:, 1] - z_ref, points[:, 2]), 1)).astype(
        np.float32
    )


def to_site(points, site):
    if site == "roundabout":
        return points
    return np.stack((196 + points[:, 1], 104 - points[:, 0], points[:, 2]), 1).astype(np.float32)


@pytest.fixture(scope="module")
def network():
    return random_network()


@pytest.fixture
def small(monkeypatch):
    """Both sites cut to a part, so that a dense network is quick; the reference points stay."""
    for site, ((x0, x1), (z0, z1)) in {
        "tjunction": ((0, 16), (0, 24)),
        "roundabout": ((-8, 8), (-16, 16)),
    }.items():
        monkeypatch.setitem(published.AREA, site, (float(x0), float(z0), float(x1), float(z1)))
        monkeypatch.setitem(EXTENTS, site, ((x0, x1), (0, 4), (z0, z1)))


def assert_raw_maps_equal(site, network, path):
    detector = load_published(checkpoint(path / "checkpoint_e30.pth", network.state_dict()), site)
    points = cloud(site)
    with torch.inference_mode():
        classes, residuals = network(*padded_voxels(points, site))
    ours = detector.head(points, frame="carla")
    assert [tuple(each.shape) for each in ours] == [
        (1, 4, *classes.shape[2:]),
        (1, 14, *classes.shape[2:]),
    ]
    assert classes.std() > 0.05  # the weights keep the signal alive
    torch.testing.assert_close(ours[0], classes, atol=1e-4, rtol=0)
    torch.testing.assert_close(ours[1], residuals, atol=1e-4, rtol=0)
    # rounding puts a point or two into the next voxel
    in_site_frame = detector.head(to_site(points, site))[1]
    assert float((in_site_frame - residuals).abs().mean()) < 0.02 * float(residuals.std())


@pytest.mark.one_in(2)
@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_raw_maps_are_those_of_the_documented_network(site, network, tmp_path, small):
    assert_raw_maps_equal(site, network, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_raw_maps_of_the_whole_site(site, network, tmp_path):
    assert_raw_maps_equal(site, network, tmp_path)


def test_no_points_give_the_empty_grids_maps(network, tmp_path, small):
    path = checkpoint(tmp_path / "c.pth", network.state_dict())
    ours = load_published(path, "tjunction").head(np.zeros((0, 3), np.float32))
    with torch.inference_mode():
        expected = network(
            torch.zeros(0, 35, 6), torch.zeros(0, 3, dtype=torch.long), (80, 10, 120)
        )
    torch.testing.assert_close(ours[0], expected[0], atol=1e-4, rtol=0)


def test_the_layout_is_the_documented_one_however_it_was_trained(network, tmp_path):
    state = network.state_dict()
    assert len(state) == 145
    assert sum(parameter.numel() for parameter in network.parameters()) == 9_460_194
    ours = VoxelNet(config.VoxelNetConfig.from_paper("tjunction")).state_dict()
    assert {published.name_in_paper(name) for name in ours} == set(state)
    prefixed = {f"module.{name}": tensor for name, tensor in network.state_dict().items()}
    assert (
        load_published(checkpoint(tmp_path / "c.pth", prefixed), "roundabout").site == "roundabout"
    )


def test_frames_turn_alike_and_digests_change():
    boxes = np.random.default_rng(0).uniform(0, 6, (20, 7))

    def ahead(of):
        return of[:, :3] + np.stack((np.cos(of[:, 6]), np.sin(of[:, 6]), np.zeros(20)), 1)

    for site in ("tjunction", "roundabout"):
        turned = published.from_network(boxes, site)
        for there, here in ((ahead(turned), ahead(boxes)), (turned[:, :3], boxes[:, :3])):
            np.testing.assert_allclose(
                published.to_network(there.astype(np.float32), site), here, atol=1e-4
            )
    carla = cloud("tjunction", 50)
    there = published.to_network(carla, "tjunction", "carla")
    np.testing.assert_allclose(
        published.to_network(to_site(carla, "tjunction"), "tjunction"), there, atol=1e-4
    )
    network = VoxelNet(config.VoxelNetConfig.from_paper("tjunction"))

    def digest(**settings):
        return published.PublishedDetector(network, "tjunction", **settings).digest

    assert digest() == digest()
    same = [
        digest(),
        digest(decoding="published"),
        digest(score_threshold=0.2),
        digest(nms_threshold=0.2),
    ]
    torch.nn.init.ones_(network.head.classes.bias)
    assert len({*same, digest()}) == 5


def documented_detections(classes, residuals, site):
    """Anchors, residuals, softmax, score and proposal suppression of the document, in loops. (k, 8)
    in their frame."""
    (x0, _), _, (z0, _) = EXTENTS[site]
    stride = 2 * VOXEL[site][0]
    classes, residuals, found = classes.double().numpy(), residuals.double().numpy(), []
    for i in range(classes.shape[2]):
        for j in range(classes.shape[3]):
            for a, yaw in enumerate((0, np.pi / 2)):
                background, vehicle = classes[0, 2 * a : 2 * a + 2, i, j]
                dx, dy, dz, dl, dw, dh, dyaw = residuals[0, 7 * a : 7 * a + 7, i, j]
                diagonal = np.hypot(3.9, 1.56)
                box = (
                    x0 + (i + 0.5) * stride + dx * diagonal,
                    1.6 + dy * 1.6,
                    z0 + (j + 0.5) * stride + dz * diagonal,
                    3.9 * np.exp(dl),
                    1.56 * np.exp(dw),
                    1.6 * np.exp(dh),
                    yaw + dyaw,
                )
                found.append((*box, 1 / (1 + np.exp(background - vehicle))))
    found = sorted((f for f in found if f[7] > 0.1), key=lambda f: -f[7])[:2000]
    kept = []
    for candidate in found:
        if all(_upright_iou(candidate, other) <= 0.3 for other in kept):
            kept.append(candidate)
    return np.array(kept[:300])


def _upright_iou(a, b):
    def sides(box):
        cos, sin = abs(np.cos(box[6])), abs(np.sin(box[6]))
        return (box[3] * cos + box[4] * sin, box[4] * cos + box[3] * sin)

    (ax, az), (bx, bz) = sides(a), sides(b)
    shared = [
        max(0, min(p + ps / 2, q + qs / 2) - max(p - ps / 2, q - qs / 2))
        for p, ps, q, qs in ((a[0], ax, b[0], bx), (a[2], az, b[2], bz))
    ]
    return np.prod(shared) / (ax * az + bx * bz - np.prod(shared))


def test_published_decoding_gives_the_documented_detections(network, tmp_path, small):
    site, path = to_site(cloud("tjunction"), "tjunction"), tmp_path / "c.pth"
    state = network.state_dict()
    classes = load_published(checkpoint(path, state), "tjunction").head(site)[0]
    # 200 reach 0.1
    unsure = torch.topk((classes[:, 1::2] - classes[:, ::2]).flatten(), 200).values[-1] + np.log(9)
    state["_rpn.rpn_head.conv_cls.bias"] = state[
        "_rpn.rpn_head.conv_cls.bias"
    ] + unsure * torch.tensor([1, 0, 1, 0])
    detector = load_published(checkpoint(path, state), "tjunction", decoding="published")
    detector.nms_threshold = 1.0  # proposals alone
    expected = documented_detections(*detector.head(site), "tjunction")
    (x0, x1), _, (z0, z1) = EXTENTS["tjunction"]
    expected = expected[
        (expected[:, 0] >= x0)
        & (expected[:, 0] <= x1)
        & (expected[:, 2] >= z0)
        & (expected[:, 2] <= z1)
    ]
    found = detector(site)
    assert 3 < len(found) == len(expected) < 300
    np.testing.assert_allclose(found.scores, expected[:, 7], atol=1e-5)
    np.testing.assert_allclose(found.boxes[:, 0], 40 - expected[:, 2], atol=1e-3)
    np.testing.assert_allclose(found.boxes[:, 1], 20 - expected[:, 0], atol=1e-3)
    np.testing.assert_allclose(found.boxes[:, 2], expected[:, 1], atol=1e-3)
    np.testing.assert_allclose(found.boxes[:, 3:6], expected[:, 3:6], rtol=1e-3)
    np.testing.assert_allclose(found.boxes[:, 6], -np.pi / 2 - expected[:, 6], atol=1e-3)
    detector.nms_threshold = 0.1
    assert 0 < len(detector(site)) <= len(found)
    assert len(load_published(path, "tjunction")(site)) >= len(detector(site))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda state: {
                key: tensor for key, tensor in state.items() if key != "_rpn.conv2_2.bn1.bias"
            },
            "lacks _rpn.conv2_2.bn1.bias: it holds 144 tensors where .* 145",
        ),
        (lambda state: state | {"more": torch.zeros(1)}, "has more besides"),
        (
            lambda state: state | {"_rpn.deconv1.weight": torch.zeros(1, 2)},
            r"_rpn.deconv1.weight must have shape \(256, 256, 4, 4\), got \(1, 2\)",
        ),
        (
            lambda state: state | {"_rpn.deconv1.bias": torch.full((256,), torch.nan)},
            "_rpn.deconv1.bias .*not finite",
        ),
        (lambda state: {"a": 3}, "no state_dict of tensors"),
    ],
)
def test_another_layout_is_one_clear_line(network, tmp_path, change, said):
    with pytest.raises(ValueError, match=said) as error:
        load_published(checkpoint(tmp_path / "c.pth", change(network.state_dict())), "tjunction")
    assert "\n" not in str(error.value)


class Intruder:
    def __reduce__(self):
        return (os.mkdir, (os.environ["INTRUDED"],))


def test_no_code_of_a_file_is_run(tmp_path, environment):
    environment(INTRUDED=str(tmp_path / "intruded"))
    torch.save({"state_dict": Intruder()}, tmp_path / "c.pth")
    with pytest.raises(ValueError, match="damaged or not a checkpoint"):
        load_published(tmp_path / "c.pth", "tjunction")
    assert not (tmp_path / "intruded").exists()


def test_files_that_are_damaged_or_missing_and_unknown_sites_are_one_clear_line(tmp_path):
    for data in (b"", b"not a checkpoint", b"PK\x03\x04" + b"x" * 99):
        (tmp_path / "c.pth").write_bytes(data)
        with pytest.raises(ValueError, match="damaged or not a checkpoint") as error:
            load_published(tmp_path / "c.pth", "tjunction")
        assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError, match="no checkpoint at"):
        load_published(tmp_path / "none.pth", "tjunction")
    with pytest.raises(ValueError, match="'crossing'"):
        load_published(tmp_path / "none.pth", "crossing")
    with pytest.raises((ValueError, TypeError)):
        published.to_network(np.zeros((2, 4), np.float32), "tjunction", "carla")
