"""What every pose of a site's pool sees of its traffic: seconds, CPU seconds and memory.

python tests/benchmarks/placement_env/bench_visibility.py [FRAMES [POSES [WORKERS [SITE]]]]   (200, all, 2, both)
"""

import resource
import sys
from time import perf_counter

import numpy as np

from placement_env.candidates.pool import pool
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.fidelity.visibility import see
from toolkit.sites.files import load_site

LIMIT = 600.0  # s


def cpu_seconds() -> float:
    """Of this process and its workers, once these have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main(frames: int = 200, poses: int | None = None, workers: int = 2, *sites: str) -> None:
    """Print a line per site."""
    for name in sites or ("tjunction", "roundabout"):
        site = load_site(name)
        moments, candidates = simulate_traffic(site, frames, 1), pool(site)
        if poses is not None:
            candidates = candidates.select(np.linspace(0, len(candidates) - 1, poses).astype(np.int64))
        start, cpu = perf_counter(), cpu_seconds()
        seen = see(moments, candidates, workers=workers)
        seconds, cpu = perf_counter() - start, cpu_seconds() - cpu
        most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        print(
            f"{name}: {len(candidates)} poses x {frames} frames, {seen.points.shape[1]} vehicles: {seconds:.0f} s"
            f" ({workers} processes, limit {LIMIT:.0f}), {cpu:.1f} CPU s, {most / 1e6:.2f} GB at most in a process",
            flush=True,
        )


if __name__ == "__main__":
    main(*(int(each) if each.isdigit() else each for each in sys.argv[1:]))
