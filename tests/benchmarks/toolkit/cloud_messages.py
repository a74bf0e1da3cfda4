"""Clouds of real lidars as messages, whole and not cropped to an area: what their images leave out, and how far points
arrive from where they were measured; kbit per sensor and frame of points, whole range images and foreground;
milliseconds to encode and decode (medians).

    python tests/benchmarks/toolkit/cloud_messages.py FOLDER LAYOUT [STEP]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from toolkit.calibration.scenes import Scenes
from toolkit.datasets.recordings import open_recording
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.foreground import decode_foreground, encode_foreground
from toolkit.detection.link.range_images import RangeImages
from toolkit.sensors.sensor import Sensor


def main(folder: str, layout: str, step: float = 0.02) -> None:
    """Print a line for each sensor."""
    samples = open_recording(Path(folder), layout)
    start = perf_counter()
    scenes = Scenes(samples)
    names = list(scenes.every)
    print(f"{len(samples)} samples, empty scenes learnt in {perf_counter() - start:.1f} s; step {step:g} m")
    codec = RangeImages(step)
    for name in names:
        clouds = (cloud for sample in samples for cloud in sample.clouds if cloud.name == name and len(cloud.points))
        rows = [_measured(cloud, scenes, codec) for cloud in clouds]
        points, left, raw, whole, bits, image_ms, whole_ms, foreground_ms = np.median(rows, axis=0)[:8]
        off = np.median([row[8:] for row in rows], axis=0)
        model = scenes.grid(name).model
        print(
            f"{name}: {model.shape[0]} x {model.shape[1]}, {points:.0f} points, {left:.0f} left out; "
            f"kbit: points {raw:.0f}, image {whole:.1f}, foreground {bits:.1f}; "
            f"ms: cloud to image {image_ms:.0f}, image coded {whole_ms:.0f}, foreground coded {foreground_ms:.0f}; "
            f"off by cm: median {off[0]:.1f}, 95 % {off[1]:.1f}, most {off[2]:.1f}"
        )


def _measured(cloud, scenes, codec) -> list[float]:  # type: ignore[no-untyped-def]
    scene, times = scenes[cloud.name].scene, [perf_counter()]
    taken = scenes.image(cloud)
    times.append(perf_counter())
    sensor = Sensor(cloud.name, taken.grid.model, cloud.world_SE3_sensor)
    message = codec.encode_image(RangeImage(sensor, taken.measurement))
    arrived = codec.decode_image(message, sensor)
    times.append(perf_counter())
    out = np.where(scene.shows(taken.measurement), np.float32(0), taken.measurement)
    sent = encode_foreground(RangeImage(sensor, out), scene, step=codec.step)
    decode_foreground(sent, scene)
    times.append(perf_counter())
    assert np.abs(arrived - taken.measurement).max() <= codec.step / 2 + 1e-5
    cells = taken.cells[taken.shown]
    there = taken.grid.model.rays().reshape(-1, 3)[cells] * arrived.ravel()[cells, None]
    off = 100 * np.linalg.norm(there - cloud.in_sensor()[taken.shown], axis=1)
    ms = (1e3 * np.diff(times)).tolist()
    sizes = [96 * len(cloud.points) / 1000, message.bits / 1000, 8 * len(sent) / 1000]
    return [len(cloud.points), float((~taken.shown).sum()), *sizes, *ms, *np.quantile(off, [0.5, 0.95, 1.0]).tolist()]


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(float, sys.argv[3:]))  # type: ignore[arg-type]
