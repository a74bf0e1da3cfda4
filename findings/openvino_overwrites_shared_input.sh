#!/bin/sh
# OpenVINO: a call that asks for copied inputs overwrites the array of an earlier call, which it had kept as its input buffer.
#
# openvino 2026.4.1 (NumPy 2.4.6), CPU. `compiled(x)` shares x by default (share_inputs=True). The compiled model keeps the request,
# and x as its input tensor, after the call has returned. `compiled(y, share_inputs=False)` copies y as asked, but into that tensor: the
# caller's x holds the values of y from then on. A detector that is called once with each setting, or whose caller keeps its input for
# later, reads another cloud's numbers without an error.
# - after compiled(x) and compiled(y, share_inputs=False): x is y;   with share_inputs=False both times: x is as it was.
# coview copies every array at the border of OpenVINO (models/network/openvino_proposal.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check openvino==2026.4.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import openvino
from openvino import opset13 as ops

ONES = np.full(4, 1, np.float32)
TWOS = np.full(4, 2, np.float32)


def first_input_after(share_first):
    """The array of a first call, after a second one with another array, which is copied."""
    values = ops.parameter([4], np.float32)
    model = openvino.Model([ops.relu(values)], [values])
    compiled = openvino.compile_model(model, "CPU")
    first = ONES.copy()
    compiled(first, share_inputs=share_first)
    compiled(TWOS.copy(), share_inputs=False)
    return first.tolist()


shared, copied = first_input_after(True), first_input_after(False)
print("first input after a shared and a copied call:", shared)
print("first input after two copied calls:", copied)
assert shared == TWOS.tolist(), "the caller's array is left alone now: coview may share again"
assert copied == ONES.tolist()
PYTHON
