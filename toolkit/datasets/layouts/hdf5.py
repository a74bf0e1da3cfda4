"""Our own recordings and the paper's published ones: one HDF5 file of depth or range images, or of recorded clouds.

Of recorded clouds: see `toolkit.datasets.layouts.hdf5_clouds`. Of images, world frame: the site's, `map_SE3_world` its
place in the map. Clouds are those of all returns, without noise, as `toolkit.points` makes them of the images; labels
are complete in the site's detection area. A published file that shows no built-in site is refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.layouts.hdf5_clouds import hdf5_clouds, holds_clouds
from toolkit.datasets.records.fields import Listing
from toolkit.datasets.sample import Rectangle, Sample, SensorCloud
from toolkit.objects import LABELS
from toolkit.points import unproject


def hdf5(path: Path) -> Listing:
    """The frames of a file, or its samples. Raises what `CoopDataset` and `hdf5_clouds` raise."""
    if holds_clouds(path):
        return hdf5_clouds(path)
    dataset = CoopDataset(path)
    xmin, ymin, xmax, ymax = dataset.site.area.tolist()

    def load(name: str) -> Sample:
        frame = dataset[int(name)]
        clouds = []
        for sensor, measurement in zip(frame.sensors, frame.measurements, strict=True):
            points, returned = unproject(sensor, measurement)
            clouds.append(SensorCloud(sensor.name, np.ascontiguousarray(points.T[returned]), sensor.pose, "world"))
        categories = tuple(LABELS[label] for label in frame.objects.labels)
        area = Rectangle((xmin, ymin, xmax, ymax))
        map_SE3_site = dataset.site.map_SE3_site
        return Sample(
            name, tuple(clouds), frame.objects, categories, complete=area, time=frame.time, map_SE3_world=map_SE3_site
        )  # fmt: skip

    return Listing(tuple(f"{k:06d}" for k in range(len(dataset))), load)
