"""Time a call and print it beside its limit."""

from collections.abc import Callable
from time import perf_counter


def report(
    name: str, call: Callable[[], object], limit_ms: float | None = None, repeats: int = 50
) -> float:
    """Print the best and median milliseconds of a call that was warmed up; return the best, which
    other programs on the machine disturb least, and which the limit is held against."""
    call()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append((perf_counter() - start) * 1e3)
    best, median = min(times), sorted(times)[len(times) // 2]
    limit = (
        ""
        if limit_ms is None
        else f"   limit {limit_ms:g} ms{'' if best <= limit_ms else '  MISSED'}"
    )
    print(f"{name:43s} {best:8.2f} ms (median {median:.2f}){limit}")
    return best
