"""Time a call and print it beside its limit."""

from collections.abc import Callable
from time import perf_counter


def report(name: str, call: Callable[[], object], limit_ms: float | None = None, repeats: int = 20) -> float:
    """Print and return the median milliseconds of a call, after one that warms it up."""
    call()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append((perf_counter() - start) * 1e3)
    median = sorted(times)[len(times) // 2]
    limit = "" if limit_ms is None else f"   limit {limit_ms:g} ms{'' if median <= limit_ms else '  MISSED'}"
    print(f"{name:45s} {median:9.2f} ms{limit}")
    return median
