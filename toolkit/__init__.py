"""What is there: sites, traffic, sensors, clouds, fusion and metrics. Nothing heavy loads until it is used."""

from pathlib import Path

from toolkit.lazy import lazily

__getattr__, __dir__ = lazily(
    __name__,
    Path(__file__).parent,
    {
        "Objects": "objects", "Detections": "objects", "Detector": "objects",
        "DepthCamera": "sensors", "SpinningLidar": "sensors", "Sensor": "sensors",
        "Frame": "frame", "Site": "site", "load_site": "site", "CoopDataset": "dataset",
        "from_depth": "clouds", "fuse": "clouds", "crop": "clouds",
        "early": "fusion", "late": "fusion", "hybrid": "fusion",
        "ClusterDetector": "cluster", "evaluate": "metrics",
    },
)  # fmt: skip
