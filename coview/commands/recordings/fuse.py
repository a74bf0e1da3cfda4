"""`coview fuse`: fuse cloud files, or check an Argoverse 2 log."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_positive
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result


def fuse(
    clouds: Positional[tuple[Path, ...]] = (),
    /,
    *,
    poses: tuple[Path, ...] = (),
    inverted: bool = False,
    area: tuple[float, float, float, float] | None = None,
    height: float = 4.0,
    floor: float = 0.0,
    voxel: float | None = None,
    out: Path | None = None,
    argoverse: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Fuse cloud files in the frame of their poses; or take an Argoverse 2 log apart, fuse it back and check it.

    Example: coview fuse north.ply south.pcd --poses poses.json --area -40 -20 40 20 --out junction.ply

    Example: coview fuse --argoverse my-log

    Args:
        clouds: ply, pcd, xyz, txt, csv, npy, npz, KITTI bin, feather.
        poses: One file with all poses, or one file for each cloud; a pipe, such as <(...), will do.
        inverted: The files give world to sensor (extrinsics) instead of sensor to world.
        area: Crop to xmin ymin xmax ymax (m).
        height: Crop above (m), with --area.
        floor: Crop below (m), with --area.
        voxel: Down-sample: of each sensor one measured point in each cube of this size (m).
        out: Where to write the fused cloud (ply, pcd or npz).
        argoverse: A log with two lidars; points per labelled cuboid are printed beside the recording's own counts.
        overwrite: Replace a file that is there.
        json: Print as JSON.
    """
    from toolkit.clouds import down_sample, save
    from toolkit.datasets.cloud_files import crop_area, fuse_files, load_poses

    if argoverse is not None:
        return _check_argoverse(argoverse, json)
    if not clouds or not poses:
        raise ValueError("give cloud files and --poses, or --argoverse LOG")
    check_positive("--voxel", voxel)
    check_file(out, inputs=[*clouds, *poses], overwrite=overwrite)
    cloud = fuse_files(clouds, load_poses(clouds, poses, inverted=inverted))
    if area is not None:
        check = "leave out --inverted" if inverted else "say --inverted if the poses are world to sensor"
        cloud = crop_area(
            cloud, area, height, floor=floor, remedy=f"give another --area, --height or --floor, or {check}"
        )
    if voxel is not None:
        cloud = down_sample(cloud, voxel)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save(cloud, out)
    points = len(cloud.point.positions)
    summary = {"files": len(clouds), "points": points, "out": out and str(out)}
    text = f"{points} points of {len(clouds)} files{f', written to {out}' if out else ''}"
    print_result(summary, text, as_json=json)
    return OK


def _check_argoverse(log: Path, as_json: bool) -> int:
    from toolkit.datasets.layouts.argoverse import check_log

    rows = check_log(log)
    lines = [f"{row.sweep}  {row.category:<24} {row.points:>6} {row.recorded:>6}" for row in rows]
    agree = sum(row.points == row.recorded for row in rows)
    text = "\n".join([*lines, f"{agree} of {len(rows)} cuboids agree"])
    print_result({"rows": [row._asdict() for row in rows]}, text, as_json=as_json)
    return OK
