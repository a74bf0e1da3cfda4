"""Networks in ONNX: ours equal torch, anybody's follow a card, and what does not fit is told in one
line."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from models import onnx_files
from models.config import VoxelNetConfig, road_users
from models.detector_loading import load_detector
from models.network.grid import voxelise
from models.network.voxelnet import VoxelNet
from models.onnx_files import OnnxDetector, card_file, export_onnx, find_card
from models.weight_files import WeightsHeader, save_weights
from toolkit.objects import CYCLIST, VEHICLE

onnx = pytest.importorskip("onnx")
AREA = (-8.0, -8.0, 8.0, 8.0)


def cloud(n=3000, seed=0):
    return np.random.default_rng(seed).uniform((-9, -9, -1), (9, 9, 4), (n, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "config",
    [
        VoxelNetConfig.light(AREA, **road_users()),
        pytest.param(
            VoxelNetConfig(
                AREA, voxel_width=16, vfe_widths=(8,), middle_widths=(8, 8, 8), rpn_widths=(8, 8, 8)
            ),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["light", "published"],
)
def test_maps_equal_torch_for_any_network(config, tmp_path):
    torch.manual_seed(0)
    network = VoxelNet(config).eval()
    torch.nn.init.normal_(network.head.classes.bias, -1.0, 0.1)
    save_weights(tmp_path / "w.safetensors", network, WeightsHeader("here"))
    export_onnx(tmp_path / "w.safetensors", tmp_path / "w.onnx")
    exported, torches = OnnxDetector(tmp_path / "w.onnx"), load_detector(tmp_path / "w.safetensors")
    for points in (cloud(), cloud(40, seed=1)):
        maps, expected = exported.run(points), network(voxelise(points, config))
        for name, each in expected._asdict().items():
            if each is not None:
                np.testing.assert_allclose(maps[name], each.detach(), atol=1e-4)
    assert len(exported(cloud())) == pytest.approx(len(torches(cloud())), abs=3)
    again = pickle.loads(pickle.dumps(exported))
    assert again.digest == exported.digest != exported.shift_grids(2).digest
    np.testing.assert_array_equal(again(cloud()).boxes, exported(cloud()).boxes)
    assert exported.quick() is exported
    assert not len(exported(cloud()[:0]))
    assert not len(exported(cloud() + np.float32([99, 0, 0])))
    with pytest.raises(ValueError, match=r"is for the area -8 -8 8 8, got -9 -8 8 8"):
        OnnxDetector(tmp_path / "w.onnx", (-9, -8, 8, 8))


def test_a_card_is_named_after_the_whole_file_and_an_earlier_name_is_read(tmp_path):
    write(tmp_path)
    path = tmp_path / "n.onnx"
    assert card_file(path) == find_card(path) == tmp_path / "n.onnx.json"
    (tmp_path / "n.json").write_text("somebody's site")
    OnnxDetector(path)
    card_file(path).rename(tmp_path / "n.json")
    assert find_card(path) == tmp_path / "n.json"
    OnnxDetector(path)


def test_a_network_is_written_with_its_card_or_not_at_all(tmp_path, fail):
    full = fail(Path, "write_text", OSError(28, "No space left on device", "t.onnx"))
    with pytest.raises(OSError, match=r"No space left|cannot write"):
        onnx_files.write_network(tmp_path / "t.onnx", b"network", {"decoded": False})
    full.undo()
    assert list(tmp_path.iterdir()) == []
    onnx_files.write_network(tmp_path / "t.onnx", b"network", {"decoded": False})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.onnx", "t.onnx.json"]


def test_the_proposal_part_can_be_exported():
    detector = load_detector("general", area=AREA)
    maps = torch.zeros(1, 48, *detector.config.map_shape)

    class WholeMaps(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.rpn = detector.network.rpn

        def forward(self, features):
            return tuple(self.rpn(features).everywhere())

    program = torch.export.export(WholeMaps(), (maps,)).module()
    for one, other in zip(program(maps), WholeMaps()(maps), strict=True):
        torch.testing.assert_close(one, other, atol=1e-4, rtol=0)


def graph(path, outputs=("boxes", "scores", "labels"), inputs=("points",), label=1):
    """A network of others: a box about the mean of all points, of score 0.9 at most, and the same
    one again."""
    from onnx import TensorProto, helper

    def constant(name, values, kind=TensorProto.FLOAT):
        array = np.asarray(values)
        return helper.make_node(
            "Constant",
            [],
            [name],
            value=helper.make_tensor(name, kind, array.shape, array.ravel().tolist()),
        )

    nodes = [
        helper.make_node("ReduceMean", ["points", "axis"], ["mean"], keepdims=1),
        constant("axis", [0], TensorProto.INT64),
        constant("size", [[4.0, 2.0, 1.5, 0.5]]),
        helper.make_node("Concat", ["mean", "size"], ["one"], axis=1),
        helper.make_node("Concat", ["one", "one", "one"], ["boxes"], axis=0),
        constant("scores", [0.9, 0.8, 0.05]),
        constant("labels", [label, label, label], TensorProto.INT64),
    ]
    kinds = {"labels": TensorProto.INT64}
    made = helper.make_graph(
        [
            node
            for node in nodes
            if node.op_type != "Constant" or node.output[0] in {*outputs, "axis", "size"}
        ],
        "others",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in inputs],
        [
            helper.make_tensor_value_info(name, kinds.get(name, TensorProto.FLOAT), None)
            for name in outputs
        ],
    )
    onnx.save(
        helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path
    )


CARD = {
    "decoded": True,
    "area": [-8, -8, 8, 8],
    "labels": ["vehicle", "cyclist"],
    "score_threshold": 0.1,
}


def write(folder, card=CARD, **more):
    graph(folder / "n.onnx", **more)
    card_file(folder / "n.onnx").write_text(card if isinstance(card, str) else json.dumps(card))
    return folder / "n.onnx"


def test_a_network_of_others_follows_its_card(tmp_path):
    detect = OnnxDetector(write(tmp_path))
    points = cloud()
    inside = points[(np.abs(points[:, :2]) < 8).all(1) & (points[:, 2] > 0) & (points[:, 2] < 4)]
    found = detect(points)
    np.testing.assert_allclose(found.boxes, [[*inside.mean(0), 4, 2, 1.5, 0.5]], atol=1e-5)
    assert (found.scores.tolist(), found.labels.tolist()) == ([pytest.approx(0.9)], [CYCLIST])
    assert len(OnnxDetector(tmp_path / "n.onnx", score_threshold=0.95)(points)) == 0
    assert len(OnnxDetector(tmp_path / "n.onnx", nms_threshold=1.0)(points)) == 2
    assert OnnxDetector(write(tmp_path, label=0))(points).labels.tolist() == [VEHICLE]


@pytest.mark.parametrize(
    ("card", "more", "said"),
    [
        ("{", {}, "Expecting property name"),
        ("[1]", {}, "object with decoded, area and labels"),
        ({**CARD, "area": [8, -8, -8, 8]}, {}, "area and height must ascend"),
        ({**CARD, "labels": ["lorry"]}, {}, "labels must be different ones"),
        ({**CARD, "decoded": 1}, {}, "decoded must be true or false"),
        ({**CARD, "colour": 1}, {}, "has no colour"),
        ({**CARD, "sha256": "0"}, {}, "sha256 the digest of the file"),
        ({**CARD, "faces": ["vehicle"]}, {}, "lack the networks of the card's faces"),
        ({**CARD, "decoded": False}, {}, "and return class_logits residuals"),
        (CARD, {"outputs": ("boxes", "scores")}, "returns boxes scores"),
        (CARD, {"inputs": ("points", "colours")}, "takes points colours"),
        (CARD, {"label": 2}, "labels below 2"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(card, more, said, tmp_path):
    with pytest.raises(ValueError, match=said) as refused:
        OnnxDetector(write(tmp_path, card, **more))
    assert "\n" not in str(refused.value)


def test_missing_and_damaged_files_and_packages(tmp_path, without_packages):
    path = write(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="ONNX Runtime cannot run it"):
        OnnxDetector(path)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"no file .*onnx"):
        OnnxDetector(path)
    path.write_bytes(content)
    card_file(path).unlink()
    with pytest.raises(FileNotFoundError, match=r"no file .*json"):
        OnnxDetector(path)
    write(tmp_path)
    without_packages("onnxruntime")
    with pytest.raises(ImportError, match=r"pip install coview\[onnx\]"):
        OnnxDetector(path)
    without_packages("onnxscript")
    with pytest.raises(ImportError, match=r"pip install coview\[onnx\]"):
        export_onnx("general", tmp_path / "g.onnx")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"area": [-2000, -2000, 2000, 2000]},
            "at most 5000000 columns of 500, but area -2000 -2000 2000 2000",
        ),
        ({"voxel_size": [1e-6, 1e-6, 0.4]}, "lower the area or raise voxel_size"),
        ({"voxel_size": [0.2, 0.2, 1e-5]}, "columns of 500"),
        ({"vfe_widths": [999_999]}, "widths of layers must be at most 4096, got 999999"),
        ({"anchor_yaws": [0.1] * 20_000}, "anchors, got"),
        ({"max_points": 10**6}, "max_points must be at most 10000"),
    ],
)
def test_sizes_that_a_card_declares_are_bounded(changes, said):
    with pytest.raises(ValueError, match=said):
        VoxelNetConfig.from_dict({"area": [-8, -8, 8, 8], **changes})


@pytest.mark.parametrize(
    ("boxes", "scores", "said"),
    [
        (
            [[0, 0, 1, 4, 2, 1.5, 0]],
            [1.5],
            r"scores must be within 0\.\.1, got 1\.5: end the network in a sigmoid",
        ),
        ([[0, 0, 1, 4, 2, 1.5, 0]], [np.nan], r"scores must be within 0\.\.1, got nan"),
        (
            [[1e30, 0, 1, 4, 2, 1.5, 0]],
            [0.9],
            "boxes must be x y z length width height yaw with sizes above 0 up to 100 m",
        ),
        ([[0, 0, 1, 4, 1e30, 1.5, 0]], [0.9], "got 0 0 1 4 1e.30 1.5 0"),
        ([[0, 0, 1, -4, 2, 1.5, 0]], [0.9], "sizes above 0"),
        ([[0, 0, np.nan, 4, 2, 1.5, 0]], [0.9], "got 0 0 nan"),
    ],
)
def test_scores_and_boxes_that_no_network_should_return_are_refused(boxes, scores, said):
    detector = object.__new__(OnnxDetector)
    detector.name = "net.onnx"
    with pytest.raises(ValueError, match=said):
        detector.check_outputs(np.array(boxes, float), np.array(scores))
    detector.check_outputs(np.array([[0, 0, 1, 4, 2, 1.5, 0]]), np.array([1.0]))
