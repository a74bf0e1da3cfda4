"""Our own recordings and the paper's published ones: one HDF5 file of depth or range images, or of recorded clouds.

Of recorded clouds: see `toolkit.datasets.layouts.hdf5_clouds`. Of images, world frame: the site's, `map_SE3_world` its
place in the map. Clouds are those of all returns, each in its sensor's body frame (x forward, y left, z up); without
noise, or as sensors with errors say them, who then do not stand where they are believed to. Labels are complete in the
site's detection area. A published file that shows no built-in site is refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.layouts.hdf5_clouds import hdf5_clouds, holds_clouds
from toolkit.datasets.readings import read_frame
from toolkit.datasets.records.fields import Listing
from toolkit.datasets.sample import Rectangle, Sample, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.objects import LABELS
from toolkit.points import unproject
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS


def hdf5(path: Path, *, errors: ErrorProfile | str = PAPER_ERRORS, noise_seed: int | None = None) -> Listing:
    """The frames of a file, or its samples. errors, noise_seed: of its sensors, as of
    `toolkit.datasets.readings.read_frame`; no seed for none. Raises what `CoopDataset`, `read_frame` and `hdf5_clouds`
    raise, ValueError for errors of clouds that were recorded."""
    if holds_clouds(path):
        if noise_seed is not None:
            raise ValueError(f"{path}: holds recorded clouds, whose sensors have errors of their own: leave out errors")
        return hdf5_clouds(path)
    dataset = CoopDataset(path)
    xmin, ymin, xmax, ymax = dataset.site.area.tolist()

    def load(name: str) -> Sample:
        frame = read_frame(dataset, int(name), errors=errors, noise_seed=noise_seed)
        clouds = []
        for k, (sensor, measurement) in enumerate(zip(frame.sensors, frame.measurements, strict=True)):
            points, returned = unproject(sensor, measurement)
            if frame.shifts and (shift := frame.shifts[k]) is not None:
                points += shift.reshape(-1, 3).T
            own = transform(invert(sensor.world_SE3_body), points.T[returned].astype(np.float64))
            clouds.append(SensorCloud(sensor.name, own.astype(np.float32), sensor.world_SE3_body))
        categories = tuple(LABELS[label] for label in frame.objects.labels)
        area = Rectangle((xmin, ymin, xmax, ymax))
        map_SE3_site = dataset.site.map_SE3_site
        return Sample(
            name, tuple(clouds), frame.objects, categories, complete=area, time=frame.time, map_SE3_world=map_SE3_site
        )  # fmt: skip

    return Listing(tuple(f"{k:06d}" for k in range(len(dataset))), load)
