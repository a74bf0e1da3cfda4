"""`import models` is instant, and `models` stands on a bare training machine."""

import subprocess
import sys


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_importing_models_loads_torch_numpy_h5py_and_shapely_at_most():
    assert run(
        "import sys, models; print('torch' in sys.modules, 'numpy' in sys.modules)"
    ).split() == ["False", "False"]
    heavy = "open3d", "libsumo", "gymnasium", "matplotlib", "safetensors", "jaxtyping"
    code = "import sys, importlib; sys.modules.update(dict.fromkeys({heavy}, None));" + (
        "[importlib.import_module('models.' + name) for name in ('network.sparse', 'detector', "
        "'published', 'network.grid', 'training.losses', 'training.samples', 'train')]"
    )
    run(code.replace("{heavy}", repr(heavy)))
