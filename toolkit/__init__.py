"""What is there: sites, traffic, sensors, clouds, fusion and metrics. Nothing heavy loads until it is used."""

from toolkit.runtime.lazy import lazily

__getattr__, __dir__ = lazily(
    __name__,
    {
        "Objects": "objects", "Detections": "objects", "Detector": "objects",
        "DepthCamera": "sensors.depth_camera", "SpinningLidar": "sensors.spinning_lidar", "Sensor": "sensors.sensor",
        "Frame": "frame", "Site": "sites.site", "load_site": "sites.files", "save_site": "sites.files",
        "CoopDataset": "datasets.dataset",
        "from_depth": "clouds", "fuse": "clouds", "crop": "clouds",
        "early": "detection.fusion", "late": "detection.fusion", "hybrid": "detection.fusion",
        "ClusterDetector": "detection.cluster", "evaluate": "detection.metrics",
    },
)  # fmt: skip
