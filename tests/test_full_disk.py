"""A disk that fills up while any of our files is written: one line that names the file, nothing
torn, nothing left."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import json, resource, signal, sys
from pathlib import Path
import numpy as np
from models.config import VoxelNetConfig
from models.training.packing import pack, recording
from models.weight_files import save_atomically
from models.training.training_log import add_figures
from models.network.voxelnet import VoxelNet
from models.weight_files import WeightsHeader, save_weights
from placement_env.fidelity.hit_model import SURROGATE_FOLDER, load_models, save_models
from placement_env.fidelity.table import load_table, save_table
from toolkit.clouds import from_points, save
from toolkit.detection.evaluation import Evaluation, save_evaluation
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.plots.curves import draw_pr_curves
from toolkit.sites.files import load_site, save_site

class Figures:
    scheme, iou, sensors, label = "early", 0.7, (0,), "vehicle"
    def as_dict(self):
        return {"scheme": "early"} | {f"figure {k}": k / 7 for k in range(900)}

class Rows(list):
    provenance = {}
    def as_dict(self):
        return {"rows": [each.as_dict() for each in self]}

site, rng = load_site("tjunction"), np.random.default_rng(0)
camera = site.sensors[0]
frames = [
    Frame((camera,), (rng.uniform(1, 20, camera.model.shape).astype(np.float32),), Objects(np.zeros((0, 7)), []), k, k)
    for k in range(9)
]
empty = [np.zeros(camera.model.shape, np.float32)]
network, cloud = VoxelNet(VoxelNetConfig.light((-8.0, -8.0, 8.0, 8.0))), from_points(rng.random((9000, 3)), 0)
models, table = load_models(SURROGATE_FOLDER / "general.json"), load_table("tjunction")
many = {f"loss {k}": 0.5 for k in range(900)}
writers = {
    "site.json": lambda path: save_site(site, path),
    "table.json": lambda path: save_evaluation(Rows([Figures()]), path.parent),
    "x.packed": lambda path: pack([recording(frames, site.area, empty=empty)], path),
    "weights.safetensors": lambda path: save_weights(path, network, WeightsHeader()),
    "checkpoint.pt": lambda path: save_atomically(path, network.state_dict()),
    "log.csv": lambda path: add_figures(path, 1, 0.1, many),
    "models.json": lambda path: save_models(models, path),
    "table.npz": lambda path: save_table(table, path),
    "cloud.ply": lambda path: save(cloud, path),
    "cloud.pcd": lambda path: save(cloud, path),
    "cloud.npz": lambda path: save(cloud, path),
    "curves.png": lambda path: draw_pr_curves({"a": (np.linspace(0, 1, 9), np.linspace(1, 0, 9))}, path),
}
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
say, report = sys.stdout, {}
for name, write in writers.items():
    for limit in (0, 1, 100, 3000):
        path = Path(f"{name}-{limit}", name)
        path.parent.mkdir()
        path.write_text("good")
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            write(path)
            said = "nothing"
        except OSError as error:
            said = str(error)
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        report[f"{path}"] = [said, path.read_bytes() == b"good", [each.name for each in path.parent.iterdir()]]
print(json.dumps(report))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files there")
def test_every_writer_says_which_file_and_leaves_what_was_there(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-B", "-c", SCRIPT],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert done.stderr == ""
    assert len(report) == 48
    for path, (said, good, names) in report.items():
        assert said.startswith("cannot write"), (path, said)
        assert Path(path).name in said
        assert "\n" not in said
        assert good, path
        assert names == [Path(path).name]
