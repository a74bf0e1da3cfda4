"""`coview detect`: find road users in clouds of any recording."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import check_least
from coview.clouds import first_of, open_clouds, watched
from coview.detectors import sample_detector
from coview.exits import OK
from coview.outputs import check_file, check_new_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar


def detect(
    clouds: Positional[tuple[Path, ...]],
    /,
    *,
    out: Path,
    poses: Path | None = None,
    inverted: bool = False,
    layout: str = "folder",
    level: Literal["map", "plane", "none"] = "map",
    still: bool = False,
    weights: str = "general",
    area: tuple[float, float, float, float] | None = None,
    frames: int | None = None,
    format: Literal["boxes", "openlabel", "kitti"] = "boxes",
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Find road users in cloud files, folders of clouds, bags and public sets, on level ground.

    Example: coview detect my-recording --level map --out boxes.json

    Example: coview detect junction.bag --layout rosbag --still --area -40 -40 40 40 --out boxes.json

    Args:
        clouds: Cloud files, folders, bags; what there is to read in each says --layout.
        out: File of boxes, or a folder for OpenLABEL or KITTI text, a file per sample.
        poses: File of poses by the names of sensors, for --layout folder; the folder's own poses.json when left out.
        inverted: It gives world to sensor (extrinsics) instead of sensor to world.
        layout: folder, kitti, openlabel, dair, opv2v, v2xset, v2xreal, rcooper, nuscenes, argoverse, sustech, rosbag or
            hdf5.
        level: Put points on the ground by a map of heights or a plane; none where the ground is at z = 0 already.
        still: The sensors do not move: the ground is found once.
        weights: Network: general, another shipped name, a weights file, or package.module:callable.
        area: Detect in xmin ymin xmax ymax (m, world frame); 50 m around the sensors when left out.
        frames: Only the first so many of each recording.
        format: Of what is written: boxes (one JSON file), openlabel or kitti.
        overwrite: Replace what is there.
        json: Print the summary as JSON.
    """
    from toolkit.detection.detect import detect_samples
    from toolkit.detection.results import described, summary, write_detections

    check_least("--frames", frames, 1, "leave it out for all")
    if not clouds:
        raise ValueError("give clouds to detect in: files, folders or bags")
    inputs = [*clouds, *([poses] if poses else [])]
    if format == "boxes":
        check_file(out, inputs=inputs, overwrite=overwrite)
    else:
        check_new_folder(out, inputs=inputs, overwrite=overwrite)
    opened = [open_clouds(path, layout, poses=poses, inverted=inverted) for path in clouds]
    total = sum(min(len(samples), frames or len(samples)) for samples in opened)
    network, middle, _ = sample_detector(weights, area)
    with progress_bar("cloud", total, hidden=json) as bar:
        samples = chain.from_iterable(first_of(each, frames) for each in opened)
        found = detect_samples(samples, network, levelling=level, middle=middle, still=still)
        written = write_detections(found, out, format, weights=weights, level=level)
        figures = summary(watched(written, bar.to))
    print_result(figures | {"out": str(out)}, f"{out}: {described(figures)}", as_json=json)
    return OK
