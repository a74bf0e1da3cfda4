"""Sound files of networks: weights of vehicles alone and of several classes, checkpoints, and what
reads them."""

import json
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from models.config import VoxelNetConfig, road_users
from models.network.voxelnet import VoxelNet
from models.published import load_published
from models.training.presets import PRESETS
from models.weight_files import WeightsHeader, save_weights


def network() -> Any:
    torch.manual_seed(0)
    return VoxelNet(
        VoxelNetConfig(
            area=(0.0, 0.0, 6.4, 6.4),
            vfe_widths=(4,),
            voxel_width=8,
            middle_widths=(4, 4, 4),
            rpn_widths=(8, 8, 8),
            rpn_layers=((0, 1), (0, 1), (0, 1)),
            upsample_width=8,
            head3x3=8,
        )
    )


def weights(path: Path) -> None:
    save_weights(path, network(), WeightsHeader("yard", 3, "abc", {"0.7": 0.5}))


def class_weights(path: Path) -> None:
    """Of several classes, with a second stage and a calibration."""
    torch.manual_seed(0)
    classes: dict[str, Any] = {
        **road_users(),
        "faces": ("heavy",),
        "calibration": ((1.2, -0.1),) * 4,
    }
    classes["rivalry"] = ((1.1, -0.2, 0.0, 0.5, 0.0, 1.0),) * 4
    made = VoxelNet(replace(network().config, head="quality", **classes))
    made.faces.prior[:] = 0.1  # type: ignore[union-attr]
    save_weights(path, made, WeightsHeader("yard", 3, "abc", {"AP@0.7": 0.5}))


def published_checkpoint(path: Path) -> None:
    torch.save(
        {"epoch": 3, "state_dict": {f"module.{k}": v for k, v in network().state_dict().items()}},
        path,
    )


def read_published_checkpoint(path: Path) -> None:
    load_published(path, "tjunction")


def checkpoint(path: Path) -> None:
    made = network()
    state = {
        "format": 1,
        "network": made.state_dict(),
        "config": made.config.to_dict(),
        "preset": asdict(next(iter(PRESETS.values()))),
        "step": 3,
        "frames": 2,
    }
    torch.save(state, path)


def read_checkpoint(path: Path) -> None:
    from models.weight_files import checkpoint_errors, read_checkpoint

    state = read_checkpoint(path)
    with checkpoint_errors(path):
        VoxelNetConfig.from_dict(state["config"])
        network().load_state_dict(state["network"])


def onnx_network() -> bytes:
    """Content of a network that finds one box in any cloud."""
    from onnx import TensorProto, helper

    values = {"boxes": ([1, 7], [3.0, 3.0, 0.8, 4.0, 1.8, 1.6, 0.1]), "scores": ([1], [0.9])}
    nodes = [
        helper.make_node(
            "Constant",
            [],
            [name],
            value=helper.make_tensor(name, TensorProto.FLOAT, shape, numbers),
        )
        for name, (shape, numbers) in values.items()
    ]
    zero = helper.make_tensor("labels", TensorProto.INT64, [1], [0])
    nodes.append(helper.make_node("Constant", [], ["labels"], value=zero))
    takes = [helper.make_tensor_value_info("points", TensorProto.FLOAT, ["n", 3])]
    gives = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, (shape, _) in values.items()
    ]
    gives.append(helper.make_tensor_value_info("labels", TensorProto.INT64, [1]))
    graph = helper.make_graph(nodes, "one", takes, gives)
    opset = [helper.make_opsetid("", 17)]
    return helper.make_model(graph, opset_imports=opset, ir_version=9).SerializeToString()


def card(path: Path) -> None:
    """Write a card of a network of boxes."""
    values = {"decoded": True, "nms_threshold": 0.1, **network().config.to_dict()}
    path.write_text(json.dumps(values, indent=1))


def read_card(path: Path) -> None:
    """Read the card next to its network, and detect."""
    from models.onnx_files import OnnxDetector, card_file

    with tempfile.TemporaryDirectory() as folder:
        onnx_file = Path(folder, "net.onnx")
        onnx_file.write_bytes(onnx_network())
        card_file(onnx_file).symlink_to(path)
        OnnxDetector(onnx_file)(np.full((50, 3), 1.0, np.float32))


def read_weights(path: Path) -> None:
    """Read weights as a detector, and detect."""
    from models.detector_loading import load_detector

    load_detector(path)(np.full((50, 3), 1.0, np.float32))
