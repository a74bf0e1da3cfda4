"""Networks that never end, or ask for gigabytes, are refused in one line, and the process that asks
stays small."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from models.onnx_files import OnnxDetector, card_file
from models.onnx_trial import TrialLimits, try_network

onnx = pytest.importorskip("onnx")
CARD = {"decoded": True, "area": [-8, -8, 8, 8], "labels": ["vehicle"]}
MANY = 1 << 15  # squared and in float32, 4 GiB
REMEDY = r"make it smaller, or give OnnxDetector limits=TrialLimits\(\.\.\.\)"


def constant(name, values, kind=np.float32):
    return onnx.helper.make_node(
        "Constant", [], [name], value=onnx.numpy_helper.from_array(np.array(values, kind))
    )


def spread(value, rows, columns):
    """Operators that make a matrix of one value."""
    return [
        constant("shape", [rows, columns], np.int64),
        onnx.helper.make_node("Expand", [value, "shape"], ["matrix"]),
    ]


def mean(name):
    return onnx.helper.make_node("ReduceMean", [name], ["burden"], keepdims=0)


def repeat(count):
    """Operators that multiply a matrix by itself, again and again."""
    helper, tensor = onnx.helper, onnx.TensorProto
    takes = [("k", tensor.INT64, []), ("go", tensor.BOOL, []), ("x", tensor.FLOAT, None)]
    gives = [("go_on", tensor.BOOL, []), ("y", tensor.FLOAT, None)]
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["go_on"]),
            helper.make_node("MatMul", ["x", "matrix"], ["y"]),
        ],
        "body",
        [helper.make_tensor_value_info(*value) for value in takes],
        [helper.make_tensor_value_info(*value) for value in gives],
    )
    loop = helper.make_node("Loop", ["count", "go_ahead", "matrix"], ["last"], body=body)
    return [
        constant("count", count, np.int64),
        constant("go_ahead", True, np.bool_),
        loop,
        mean("last"),
    ]


def first_point():
    return onnx.helper.make_node("ReduceMax", ["points"], ["top"], keepdims=0)


BURDENS = {
    "a loop without end": lambda: [first_point(), *spread("top", 8, 8), *repeat(1 << 60)],
    "a constant without end": lambda: [
        constant("top", 0.0),
        *spread("top", 8, 8),
        *repeat(1 << 60),
    ],
    "gigabytes": lambda: [first_point(), *spread("top", MANY, MANY), mean("matrix")],
    "a constant of gigabytes": lambda: [
        constant("top", 0.0),
        *spread("top", MANY, MANY // 4),
        mean("matrix"),
    ],
    "nothing": lambda: [first_point(), *spread("top", 8, 8), mean("matrix")],
}


def write(path, burden):
    """A network of others that finds one box, once it has carried its burden."""
    helper, tensor = onnx.helper, onnx.TensorProto
    nodes = [
        *BURDENS[burden](),
        constant("zero", 0.0),
        helper.make_node("Mul", ["burden", "zero"], ["nothing"]),
        constant("box", [[0, 0, 1, 4, 2, 1.5, 0]]),
        helper.make_node("Add", ["box", "nothing"], ["boxes"]),
        constant("scores", [0.9]),
        constant("labels", [0], np.int64),
    ]
    gives = {"boxes": tensor.FLOAT, "scores": tensor.FLOAT, "labels": tensor.INT64}
    graph = helper.make_graph(
        nodes,
        "burden",
        [helper.make_tensor_value_info("points", tensor.FLOAT, ["n", 3])],
        [helper.make_tensor_value_info(name, kind, None) for name, kind in gives.items()],
    )
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path
    )
    card_file(path).write_text(json.dumps(CARD))
    assert path.stat().st_size < 2000
    return path


def peak_kib():
    """Most memory that this process ever held, children aside."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("the system does not tell how much memory a process held")
    return int(status.read_text().split("VmHWM:")[1].split()[0])


@pytest.mark.parametrize("burden", ["a loop without end", "a constant of gigabytes"])
def test_a_slow_or_greedy_network_is_refused_in_one_line(burden, tmp_path):
    path, before = write(tmp_path / "n.onnx", burden), peak_kib()
    with pytest.raises(
        ValueError, match=rf"n\.onnx and n\.onnx\.json make no detector: .*{REMEDY}"
    ) as refused:
        OnnxDetector(path, limits=TrialLimits(seconds=0.8, memory_bytes=200 << 20))
    assert "\n" not in str(refused.value)
    assert peak_kib() - before < 100 << 10


@pytest.mark.slow
@pytest.mark.parametrize("burden", BURDENS)
def test_a_network_opens_within_the_limits_or_not_at_all(burden, tmp_path):
    path, before, start = write(tmp_path / "n.onnx", burden), peak_kib(), time.monotonic()
    if burden == "nothing":
        assert len(OnnxDetector(path)(np.zeros((9, 3), np.float32) + 1)) == 1
        return
    reason = (
        "takes more than 15 s" if "end" in burden else r"cannot run it with two points in 1\.5 GiB"
    )
    with pytest.raises(ValueError, match=reason):
        OnnxDetector(path)
    assert time.monotonic() - start < 60  # 15 on an idle machine, and never without end
    assert peak_kib() - before < 100 << 10


def test_a_network_that_ends_its_process_is_refused_and_ours_goes_on(monkeypatch):
    monkeypatch.setattr("models.onnx_trial.sys.executable", "false")
    with pytest.raises(ValueError, match=r"cannot run it .* \(exit code 1\)"):
        try_network(b"", {}, TrialLimits())


@pytest.mark.parametrize(
    "limits", [{"seconds": 0}, {"seconds": float("nan")}, {"memory_bytes": -1}]
)
def test_limits_are_above_0(limits):
    with pytest.raises(ValueError, match="limits of a trial must be above 0"):
        TrialLimits(**limits)
