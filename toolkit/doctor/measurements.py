"""Measurements of a file of images, compared with its objects and its site."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset
from toolkit.doctor.examination import Examination
from toolkit.doctor.findings import Finding, report_error
from toolkit.doctor.image_failures import failing_sensors
from toolkit.doctor.sensor_images import SensorImages, read_images
from toolkit.doctor.site_area import UNKNOWN_SITE, in_area
from toolkit.geometry import level_rows
from toolkit.points import count_on_ground

MAX_CHECKED_FRAMES = 60  # largest number of frames that are looked at, evenly spread over the file
MIN_INSIDE_SHARE = 0.01  # least share of points in the detection area of a sensor that sees it
MAX_UNSEEN_SHARE = 0.3  # largest share of the objects in the area that may be without a point
MAX_FLOATING_M = 0.25  # largest distance between a box's floor and the ground
_UNITS = {  # unit of depth by the factor that turns it into metres
    0.01: "centimetres",
    0.001: "millimetres",
    published.NO_RETURN_M: "parts of the far plane, 0 to 1",
}


def check_measurements(
    dataset: CoopDataset, tables: Sequence[np.ndarray], units: Sequence[float] = (1.0,)
) -> list[Finding]:
    """Compare the images of some frames with the objects and the site, and return all findings.

    Args:
        dataset: the file of images.
        tables: published rows of the objects of all frames.
        units: factors that may turn depth in `dslices` into metres, at least one. The factor is
            taken that makes points and boxes agree best."""
    frames = np.unique(
        np.linspace(0, len(dataset) - 1, min(len(dataset), MAX_CHECKED_FRAMES)).astype(int)
    ).tolist()
    stored_views, findings = read_images(dataset, frames)
    # the unit is in doubt only for dslices, the dataset that cameras share
    has_unsure_unit = [channel.depth_index is not None for channel in dataset.channels]
    exams = []  # an examination with each unit
    for unit in units:
        views = []
        for view, is_unsure in zip(stored_views, has_unsure_unit, strict=True):
            depth_m = view.depth * np.float32(unit if is_unsure else 1.0)
            far_m = min(view.sensor.model.max_range, published.NO_RETURN_M)
            # the far plane and all beyond are no return
            near_depth_m = np.where(depth_m < far_m * 0.999, depth_m, np.float32(0))
            views.append(replace(view, depth=near_depth_m))
        exams.append(Examination(dataset.site, views, tables, frames))
    best = max(range(len(units)), key=lambda i: exams[i].explained_count)
    if units[best] != 1:
        largest = max(
            float(view.depth.max(initial=0))
            for view, is_unsure in zip(stored_views, has_unsure_unit, strict=True)
            if is_unsure
        )
        evidence = (
            f"the largest number is {largest:g}, the far plane lies at {published.NO_RETURN_M:g} m"
        )
        words = f"depth in {_UNITS.get(units[best], 'another unit')} instead of metres"
        findings.append(
            report_error(
                where="dslices",
                suspected=words,
                evidence=evidence,
                remedy=f"multiply by {units[best]:g}",
            )
        )
    exam = exams[best]
    findings += [*_suspect_blind(exam.views, frames), *exam.disagreements()]
    findings += [*_suspect_posture(exam), *_suspect_floating(exam), *_suspect_unseen(exam)]
    return [*findings, *failing_sensors(exam.views, exam.rows, dataset.site, frames)]


def _suspect_blind(views: Sequence[SensorImages], frames: Sequence[int]) -> Iterator[Finding]:
    """Find sensors that never return a point, and frames in which no sensor does.

    frames: numbers in the file of the frames that are looked at."""
    blind_names = [view.sensor.name for view in views if not view.depth.any()]
    for name in blind_names:
        yield report_error(
            where=f"sensor {name}",
            suspected="no points",
            evidence=f"not one pixel of {len(frames)} frames returned",
            remedy="check its images and their unit, or leave it out",
        )
    has_points = np.zeros(len(frames), bool)
    for view in views:
        has_points |= view.depth.any(axis=1)  # depth: (frames, pixels), 0 without a return
    empty_frames = [number for i, number in enumerate(frames) if not has_points[i]]
    # if all sensors are blind, they have their findings already
    if empty_frames and len(blind_names) < len(views):
        first_empty = empty_frames[0]
        count_words = f"{len(empty_frames)} of {len(frames)} frames that were looked at"
        yield report_error(
            where=f"frame {first_empty}",
            suspected="frames without points",
            evidence=f"{count_words}, the first is {first_empty}",
            remedy="restore their images or leave them out",
        )


def _suspect_posture(exam: Examination) -> Iterator[Finding]:
    """Find sensors under the ground, upside down, or facing away from the detection area.

    Sensors with a suspected mistake of their pose or depth are skipped."""
    site = exam.site
    for view in exam.views:
        sensor = view.sensor
        where = f"sensor {view.sensor.name}"
        if exam.doubts.get(sensor.name) is not None:
            continue
        # x and y of the sensor's forward axis, and z of its up axis: unit vectors, site frame
        forward_xy = sensor.world_SE3_body[:2, 0]
        up_z = sensor.world_SE3_body[2, 2]
        sensor_xy, sensor_z = sensor.position[:2], sensor.position[2]
        height = float(sensor_z - site.ground(sensor_xy))  # above the ground (m)
        if height < 0:
            yield report_error(
                where=where,
                suspected="it stands under the ground",
                evidence=f"height {height:.2f} m",
                remedy="check z and signs of its pose",
            )
        if up_z < -0.1:
            yield report_error(
                where=where,
                suspected="it hangs upside down",
                evidence=f"its up has z {up_z:.2f}",
                remedy="check the signs in its pose",
            )
        # points of the first five frames
        points = np.concatenate([view.points(frame) for frame in range(min(len(view.depth), 5))])
        is_inside = in_area(points[:, :2], site)
        if len(points) and site.name != UNKNOWN_SITE and is_inside.mean() < MIN_INSIDE_SHARE:
            to_centre = (site.area[:2] + site.area[2:]) / 2 - sensor_xy
            cross = forward_xy[0] * to_centre[1] - forward_xy[1] * to_centre[0]
            turn_deg = np.rad2deg(np.arctan2(cross, forward_xy @ to_centre))
            direction = f"whose centre lies {turn_deg:.0f} degrees to its left"
            evidence = f"{is_inside.mean():.1%} of its points in the area, {direction}"
            yield report_error(
                where=where,
                suspected="it looks away from the detection area",
                evidence=evidence,
                remedy="check its heading and the area",
            )


def _suspect_floating(exam: Examination) -> Iterator[Finding]:
    """Find boxes whose floor is above or below the ground next to them, if this is usual."""
    slope = exam.site.relief.slope
    gaps_m = []  # heights of boxes' floors above the ground next to them
    for objects, cloud in exam.sample_clouds():
        # with the site's slope taken off; every fourth point, to save time
        points = level_rows(cloud[::4], slope)
        for x, y, z, length, width, height, _ in level_rows(objects.boxes, slope):
            distances = np.hypot(points[:, 0] - x, points[:, 1] - y)  # seen from above
            radius = np.hypot(length, width) / 2
            # points in a ring of 2 m around the box; the low ones are on the ground
            is_in_ring = (distances > radius) & (distances < radius + 2)
            ring_z = points[is_in_ring, 2]
            # fewer do not show the ground
            if len(ring_z) >= 20:
                floor_z = z - height / 2
                gaps_m.append(floor_z - np.percentile(ring_z, 10))
    # fewer than ten boxes may be chance
    if len(gaps_m) >= 10 and abs(np.median(gaps_m)) > MAX_FLOATING_M:
        gap = float(np.median(gaps_m))
        word, side = ("float above", "above") if gap > 0 else ("are sunk into", "below")
        evidence = f"their floor is {abs(gap):.2f} m {side} it, median of {len(gaps_m)} boxes"
        remedy = f"add {-gap:.2f} m to column 2 (z) of objects"
        yield report_error(
            where="objects",
            suspected=f"the boxes {word} the ground",
            evidence=evidence,
            remedy=remedy,
        )


def _suspect_unseen(exam: Examination) -> Iterator[Finding]:
    """Find objects in the area without a point, if they are too many to be hidden.

    At an unknown site the area is unknown too."""
    if exam.site.name == UNKNOWN_SITE:
        return
    # numbers of points on each object in the area, an array for each frame
    point_counts = [np.zeros(0, np.int64)]
    for objects, points in exam.sample_clouds():
        if len(points):
            objects_inside = objects[in_area(objects.boxes[:, :2], exam.site)]
            point_counts.append(count_on_ground(points, objects_inside.boxes, exam.site))
    is_unseen = np.concatenate(point_counts) == 0
    if len(is_unseen) >= 10 and is_unseen.mean() > MAX_UNSEEN_SHARE:
        evidence = f"{is_unseen.sum()} of {len(is_unseen)} objects in the detection area"
        remedy = "check poses and boxes, and that images and objects belong to the same frames"
        yield Finding(
            severity="warning",
            where="objects",
            suspected="objects without a point from any sensor",
            evidence=evidence,
            remedy=remedy,
        )
