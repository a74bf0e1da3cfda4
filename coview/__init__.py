"""coview plans roadside perception: what it offers, under one name; nothing loads before it is used.

>>> from coview import load_site
>>> load_site("tjunction").name
'tjunction'
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

try:
    __version__ = version("coview")
except PackageNotFoundError:  # a checkout that is not installed
    __version__ = "0+unknown"

if TYPE_CHECKING:
    from models.detector import VoxelNetDetector as VoxelNetDetector
    from models.detector import load_detector as load_detector
    from placement_env.candidates.candidates import Candidates as Candidates
    from placement_env.candidates.poles import load_poles as load_poles
    from placement_env.candidates.pool import paper_candidates as paper_candidates
    from placement_env.candidates.pool import pool as pool
    from placement_env.fidelity.table import load_table as load_table
    from placement_env.objective import Objective as Objective
    from placement_env.objective import Score as Score
    from placement_env.setting import Weights as Weights
    from toolkit.clouds import crop as crop
    from toolkit.clouds import from_depth as from_depth
    from toolkit.clouds import fuse as fuse
    from toolkit.clouds import points_per_box as points_per_box
    from toolkit.datasets.cloud_files import fuse_files as fuse_files
    from toolkit.datasets.dataset import CoopDataset as CoopDataset
    from toolkit.datasets.doctor import diagnose as diagnose
    from toolkit.datasets.simulation import simulate_dataset as simulate_dataset
    from toolkit.detection.cluster import ClusterDetector as ClusterDetector
    from toolkit.detection.evaluation import evaluate_dataset as evaluate_dataset
    from toolkit.detection.evaluation import format_table as format_table
    from toolkit.detection.metrics import evaluate as evaluate
    from toolkit.detection.survey import survey as survey
    from toolkit.frame import Frame as Frame
    from toolkit.objects import Detections as Detections
    from toolkit.objects import Detector as Detector
    from toolkit.objects import Objects as Objects
    from toolkit.sensors.models import DepthCamera as DepthCamera
    from toolkit.sensors.models import SpinningLidar as SpinningLidar
    from toolkit.sensors.sensor import Sensor as Sensor
    from toolkit.sites.files import load_site as load_site
    from toolkit.sites.files import save_site as save_site
    from toolkit.sites.site import Site as Site
else:
    _MODULES = {
        "models.detector": ("VoxelNetDetector", "load_detector"),
        "placement_env.candidates.candidates": ("Candidates",),
        "placement_env.candidates.poles": ("load_poles",),
        "placement_env.candidates.pool": ("paper_candidates", "pool"),
        "placement_env.fidelity.table": ("load_table",),
        "placement_env.objective": ("Objective", "Score", "Weights"),
        "toolkit.clouds": ("crop", "from_depth", "fuse", "points_per_box"),
        "toolkit.datasets.cloud_files": ("fuse_files",),
        "toolkit.datasets.dataset": ("CoopDataset",),
        "toolkit.datasets.doctor": ("diagnose",),
        "toolkit.datasets.simulation": ("simulate_dataset",),
        "toolkit.detection.cluster": ("ClusterDetector",),
        "toolkit.detection.evaluation": ("evaluate_dataset", "format_table"),
        "toolkit.detection.metrics": ("evaluate",),
        "toolkit.detection.survey": ("survey",),
        "toolkit.frame": ("Frame",),
        "toolkit.objects": ("Detections", "Detector", "Objects"),
        "toolkit.sensors.models": ("DepthCamera", "SpinningLidar"),
        "toolkit.sensors.sensor": ("Sensor",),
        "toolkit.sites.files": ("load_site", "save_site"),
        "toolkit.sites.site": ("Site",),
    }
    _HOMES = {name: module for module, names in _MODULES.items() for name in names}

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)

    def __dir__() -> list[str]:
        return ["__version__", *sorted(_HOMES)]
