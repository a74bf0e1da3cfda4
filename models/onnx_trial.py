"""Trial of an ONNX network in another process, with limited time and memory.

ONNX Runtime computes what is constant while it opens a file, and stops between operators only: no
limit inside the process that asks holds a network to its time, and one that ends the process ends
it with everything in it."""

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from typing import Any

import numpy as np

from toolkit.runtime.reading import limit_memory

_passed: set[str] = set()  # digests of the trials that this process need not repeat


@dataclass(frozen=True)
class TrialLimits:
    """Limits of a network's first run.

    Attributes:
        seconds: Time to open it and run it with two points on one core.
        memory_bytes: Memory mapped for that, beyond what ONNX Runtime itself takes. Linux only."""

    seconds: float = 15.0
    memory_bytes: int = 3 << 29

    def __post_init__(self) -> None:
        """Raise ValueError for a limit of 0 or less."""
        if not (self.seconds > 0 and self.memory_bytes > 0):
            raise ValueError(
                f"limits of a trial must be above 0, got {self.seconds} s and {self.memory_bytes} "
                "bytes"
            )


def try_network(content: bytes, inputs: Mapping[str, np.ndarray], limits: TrialLimits) -> None:
    """Open a network and run it once in another process.

    content: content of the ONNX file; inputs: arrays by name; a network that takes others is opened
    only. Raises ValueError if it fails or passes a limit."""
    payload = BytesIO()
    arrays: dict[str, Any] = {"network": np.frombuffer(content, np.uint8), **inputs}
    np.savez(payload, **arrays)
    digest = sha256(payload.getvalue()).hexdigest()
    if digest in _passed:
        return
    command = [sys.executable, "-m", __name__, str(limits.memory_bytes)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    remedy = "make it smaller, or give OnnxDetector limits=TrialLimits(...)"
    try:
        child = subprocess.run(
            command,
            input=payload.getvalue(),
            capture_output=True,
            env=environment,
            timeout=limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(
            f"its first run, with two points, takes more than {limits.seconds:g} s: {remedy}"
        ) from None
    if child.returncode:
        reason = (
            " ".join(child.stderr.decode(errors="replace").split())
            or f"exit code {child.returncode}"
        )
        memory = f"{limits.memory_bytes / 2**30:.3g} GiB"
        raise ValueError(
            f"ONNX Runtime cannot run it with two points in {memory}: check the file, {remedy} "
            f"({reason})"
        )
    _passed.add(digest)


def _run_trial(memory_bytes: int) -> None:
    """Run a network with its inputs, both from an .npz on standard input.

    It holds the bytes of the ONNX file as "network", and arrays by the names of inputs; a network
    with other inputs is opened only. memory_bytes: limit of memory. Exits with a line on stderr if
    the run fails."""
    import onnxruntime

    arrays = dict(np.load(BytesIO(sys.stdin.buffer.read())))
    content = arrays.pop("network").tobytes()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # each thread maps more memory
    options.log_severity_level = 4
    try:
        with limit_memory(memory_bytes):
            session = onnxruntime.InferenceSession(content, options, ["CPUExecutionProvider"])
            names = {tensor.name for tensor in session.get_inputs()}
            if names <= arrays.keys():
                session.run(None, {name: arrays[name] for name in names})
    except Exception as error:  # errors of ONNX Runtime share no class
        sys.exit(str(error))


if __name__ == "__main__":
    _run_trial(int(sys.argv[1]))
