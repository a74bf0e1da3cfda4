"""`coview fuse`: fuse cloud files, or check an Argoverse 2 log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_positive
from coview.outputs import OK, Writing, check_file, print_result


@dataclass(frozen=True)
class Crop:
    """Part of the fused cloud to keep."""

    area: tuple[float, float, float, float] | None = None
    """Keep points in xmin ymin xmax ymax (m)."""
    height: float = 4.0
    """Keep points below this height (m), with --area."""
    floor: float = 0.0
    """Keep points above this height (m), with --area."""
    voxel: float | None = None
    """Keep one point of each sensor in every cube of this size (m)."""


def fuse(
    clouds: Positional[tuple[Path, ...]] = (),
    /,
    *,
    poses: tuple[Path, ...] = (),
    inverted: bool = False,
    out: Path | None = None,
    argoverse: Path | None = None,
    crop: Crop = Crop(),
    writing: Writing = Writing(),
) -> int:
    """Fuse cloud files in the frame of their poses; or take an Argoverse 2 log apart, fuse it back and check it.

    Example: coview fuse north.ply south.pcd --poses poses.json --area -40 -20 40 20 --out junction.ply

    Example: coview fuse --argoverse my-log

    Args:
        clouds: Cloud files: ply, pcd, xyz, txt, csv, npy, npz, KITTI bin or feather.
        poses: One file with all poses, or one per cloud; pipes such as <(...) work too.
        inverted: Take the poses as world to sensor (extrinsics) instead of sensor to world.
        out: File for the fused cloud (ply, pcd or npz).
        argoverse: Log with two lidars; prints its points per labelled cuboid beside the recorded counts.
    """
    from toolkit.clouds import down_sample, save
    from toolkit.datasets.cloud_files import crop_area, fuse_files, load_poses

    if argoverse is not None:
        from toolkit.datasets.layouts.argoverse import check_log

        rows = check_log(argoverse)
        lines = [f"{row.sweep}  {row.category:<24} {row.points:>6} {row.recorded:>6}" for row in rows]
        text = "\n".join([*lines, f"{sum(row.points == row.recorded for row in rows)} of {len(rows)} cuboids agree"])
        print_result({"rows": [row._asdict() for row in rows]}, text, as_json=writing.json)
        return OK
    if not clouds or not poses:
        raise ValueError("give cloud files and --poses, or --argoverse LOG")
    check_positive("--voxel", crop.voxel)
    check_file(out, inputs=[*clouds, *poses], overwrite=writing.overwrite)
    cloud = fuse_files(clouds, load_poses(clouds, poses, inverted=inverted))
    if crop.area is not None:
        check = "leave out --inverted" if inverted else "say --inverted if the poses are world to sensor"
        remedy = f"give another --area, --height or --floor, or {check}"
        cloud = crop_area(cloud, crop.area, crop.height, floor=crop.floor, remedy=remedy)
    if crop.voxel is not None:
        cloud = down_sample(cloud, crop.voxel)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save(cloud, out)
    points = len(cloud.point.positions)
    summary = {"files": len(clouds), "points": points, "out": out and str(out)}
    text = f"{points} points of {len(clouds)} files{f', written to {out}' if out else ''}"
    print_result(summary, text, as_json=writing.json)
    return OK
