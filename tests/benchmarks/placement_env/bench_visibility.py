"""What every pose of a site's pool sees of its traffic: seconds, CPU seconds and memory, from
panoramas or in full; and how far panoramas are from full rendering.

python tests/benchmarks/placement_env/bench_visibility.py [FRAMES [POSES [WORKERS [SITE]]]]   (200,
                                                                                              all,
                                                                                              2,
                                                                                              both)
                                                                                              --full
                                                                                              cast
                                                                                              every
                                                                                              ray of
                                                                                              every
                                                                                              pose
                                                                                              --agree
                                                                                              both
                                                                                              ways
                                                                                              for
                                                                                              poses
                                                                                              of
                                                                                              some
                                                                                              sensor
                                                                                              models
                                                                                              and
                                                                                              tilts:
                                                                                              how
                                                                                              many
                                                                                              objects
                                                                                              agree
                                                                                              within
                                                                                              3 % or
                                                                                              8
                                                                                              points
"""

import resource
import sys
from time import perf_counter

import numpy as np

from placement_env.candidates.candidates import pool
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.setting import Rendering
from toolkit.objects import LABELS
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sites.files import load_site

LIMIT = 60.0  # s


def cpu_seconds() -> float:
    """Of this process and its workers, once these have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def agreement(frames: int, poses: int, name: str) -> None:
    """Print a line per sensor model and set of tilts."""
    site = load_site(name)
    traffic, labels = simulate_traffic(site, frames, 1), tuple(range(len(LABELS)))
    for model in (DepthCamera(), SpinningLidar(), SolidStateLidar()):
        for tilts in ((5.0, 15.0, 25.0), (7.3, 33.0)):
            candidates = pool(site, models=(model,), tilts=np.deg2rad(tilts).tolist())
            rng = np.random.default_rng(0)
            candidates = candidates.select(
                np.sort(rng.choice(len(candidates), poses, replace=False))
            )
            full, quick = (
                see(traffic, candidates, labels=labels, rendering=way)
                for way in ("full", "panorama")
            )
            seen = (full.points > 0) | (quick.points > 0)
            off = np.abs(full.points - quick.points)[seen]
            within = off <= np.maximum(0.03 * full.points[seen], 8)
            sent = np.abs(quick.sent - full.sent).mean() / full.sent.mean()
            print(
                f"{name}, {type(model).__name__} at {tilts}: {within.mean():.4f} of {seen.sum()} "
                f"agree, {off.max():.0f} points off at worst, {off.mean():.2f} in the mean; all "
                f"points {quick.points.sum() / full.points.sum() - 1:+.4f}; sent {sent:.4f} off "
                "in the mean",
                flush=True,
            )


def main(
    frames: int = 200,
    poses: int | None = None,
    workers: int = 2,
    *sites: str,
    rendering: Rendering = "panorama",
) -> None:
    for name in sites or ("tjunction", "roundabout"):
        site = load_site(name)
        moments, candidates = simulate_traffic(site, frames, 1), pool(site)
        if poses is not None:
            candidates = candidates.select(
                np.linspace(0, len(candidates) - 1, poses).astype(np.int64)
            )
        start, cpu = perf_counter(), cpu_seconds()
        seen = see(moments, candidates, run=Run(workers=workers), rendering=rendering)
        seconds, cpu = perf_counter() - start, cpu_seconds() - cpu
        most = max(
            resource.getrusage(who).ru_maxrss
            for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        print(
            f"{name}: {len(candidates)} poses x {frames} frames, {seen.points.shape[1]} vehicles: "
            f"{seconds:.0f} s ({rendering}, {workers} processes, limit {LIMIT:.0f}), {cpu:.1f} "
            f"CPU s, {most / 1e6:.2f} GB at most in a process",
            flush=True,
        )


if __name__ == "__main__":
    given = [
        int(each) if each.isdigit() else each for each in sys.argv[1:] if not each.startswith("--")
    ]
    if "--agree" in sys.argv:
        frames, poses = given[:2] or (3, 60)
        for place in given[3:] or ("tjunction", "roundabout"):
            agreement(int(frames), int(poses), str(place))
    else:
        main(*given, rendering="full" if "--full" in sys.argv else "panorama")
