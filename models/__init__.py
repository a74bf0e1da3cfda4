"""Detection: VoxelNet, its training and its weights.

Needs torch, numpy, h5py and shapely only, each loaded when used.
"""

from typing import TYPE_CHECKING

from toolkit.runtime.lazy import lazily

# isort: off
if TYPE_CHECKING:
    from models.config import VoxelNetConfig as VoxelNetConfig
    from models.detector import VoxelNetDetector as VoxelNetDetector, load_detector as load_detector
    from models.training.packing import pack as pack
    from models.published import PublishedDetector as PublishedDetector, load_published as load_published
    from models.network.sparse import SparseVoxelNet as SparseVoxelNet
    from models.network.voxelnet import Prediction as Prediction, VoxelNet as VoxelNet
    from models.network.voxels import Voxels as Voxels, collate as collate, voxelise as voxelise
    from models.weight_files import Header as Header, load_weights as load_weights, save_weights as save_weights
else:
    __getattr__, __dir__, __all__ = lazily(
        __name__,
        {
            "config": ("VoxelNetConfig",),
            "detector": ("VoxelNetDetector", "load_detector"),
            "network.sparse": ("SparseVoxelNet",),
            "network.voxelnet": ("Prediction", "VoxelNet"),
            "network.voxels": ("Voxels", "collate", "voxelise"),
            "published": ("PublishedDetector", "load_published"),
            "training.packing": ("pack",),
            "weight_files": ("Header", "load_weights", "save_weights"),
        },
    )
