"""Rendering the traffic of both built-in sites, beside Open3D casting the same rays into one ready
scene of everything.

python tests/benchmarks/toolkit/bench_render.py
"""

from itertools import cycle

import numpy as np
import open3d as o3d
from timing import report

from toolkit.bodies.body import Body
from toolkit.bodies.fleet import catalogue
from toolkit.geometry import pose, transform
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.static_scene import build_scenery
from toolkit.sites.files import load_site
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot, simulate

FRAMES = 30


def whole_scene(
    site: Site, bodies: tuple[Body, ...], snapshot: Snapshot
) -> o3d.t.geometry.RaycastingScene:
    """What stands and what moves in one scene, world frame."""
    scene, still = o3d.t.geometry.RaycastingScene(), build_scenery(site)
    scene.add_triangles(still.vertices.astype(np.float32), still.triangles.astype(np.uint32))
    for (x, y, z, *_, yaw), body in zip(snapshot.objects.boxes, snapshot.bodies, strict=True):
        vertices = transform(pose(x, y, z, yaw=yaw), bodies[body].vertices.astype(np.float64))
        scene.add_triangles(vertices.astype(np.float32), bodies[body].triangles.astype(np.uint32))
    return scene


def all_rays(site: Site) -> o3d.core.Tensor:
    directions = np.stack([sensor.model.rays() @ sensor.pose[:3, :3].T for sensor in site.sensors])
    origins = np.broadcast_to(
        np.stack([s.position for s in site.sensors])[:, None, None], directions.shape
    )
    return o3d.core.Tensor(np.concatenate([origins, directions], axis=-1).astype(np.float32))


def main() -> None:
    bodies = catalogue()
    for name in ("tjunction", "roundabout"):
        site = load_site(name)
        snapshots = list(simulate(site, bodies, frames=FRAMES, seed=1))
        renderer, rays, scene = (
            Renderer(site, bodies, site.sensors),
            all_rays(site),
            whole_scene(site, bodies, snapshots[0]),
        )
        moments = cycle(snapshots)
        raw = report(f"{name}: cast_rays, scene ready", lambda r=rays, s=scene: s.cast_rays(r))
        ours = report(
            f"{name}: render", lambda m=moments, r=renderer: r.render(next(m)), repeats=2 * FRAMES
        )
        report(f"{name}: scenery", lambda s=site: build_scenery(s), repeats=3)
        print(f"{name}: {raw / ours:.2f} times the raw rate of rays, at least 0.8 wanted")


if __name__ == "__main__":
    main()
