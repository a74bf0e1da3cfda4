"""What is seen: VoxelNet, its training and its weights. Needs torch, numpy, h5py and shapely only, each when used."""

from toolkit.runtime.lazy import lazily

__getattr__, __dir__ = lazily(
    __name__,
    {
        "VoxelNetConfig": "config",
        "Voxels": "voxels", "voxelise": "voxels", "collate": "voxels",
        "VoxelNet": "voxelnet", "Prediction": "voxelnet", "SparseVoxelNet": "sparse",
        "VoxelNetDetector": "detector", "load_detector": "detector",
        "PublishedDetector": "published", "load_published": "published",
        "Header": "weights", "load_weights": "weights", "save_weights": "weights",
    },
)  # fmt: skip
