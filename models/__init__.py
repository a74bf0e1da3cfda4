"""What is seen: VoxelNet, its training and its weights. Needs torch, numpy, h5py and shapely only, each when used."""

from importlib import import_module
from typing import Any

_WHERE = {
    "VoxelNetConfig": "config",
    "Voxels": "voxels", "voxelise": "voxels", "collate": "voxels",
    "VoxelNet": "voxelnet", "Prediction": "voxelnet",
    "SparseVoxelNet": "sparse",
    "VoxelNetDetector": "detector", "load_detector": "detector",
    "PublishedDetector": "published", "load_published": "published",
    "Header": "weights", "load_weights": "weights", "save_weights": "weights",
}  # fmt: skip
_MODULES = (
    "anchors", "config", "detector", "losses", "packed", "published", "samples", "sparse", "targets", "train",
    "validation", "voxelnet", "voxels", "weights",
)  # fmt: skip
__all__ = sorted([*_WHERE, *_MODULES])  # pyright: ignore


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(import_module(f"models.{_WHERE[name]}"), name)
    if name in _MODULES:
        return import_module(f"models.{name}")
    raise AttributeError(f"module 'models' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
