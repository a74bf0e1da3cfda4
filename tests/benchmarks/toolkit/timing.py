"""Time a call and print it beside its limit."""

from collections.abc import Callable
from time import perf_counter

from tests.benchmarks.figures import record


def report(
    name: str,
    call: Callable[[], object],
    limit_ms: float | None = None,
    repeats: int = 50,
    row: tuple[str, str] | None = None,
) -> float:
    """Print the best and median milliseconds of a call that was warmed up, and return the best.

    Other programs on the machine disturb the best least, so the limit is held against it.

    Args:
        name: What is printed.
        call: What is timed.
        limit_ms: Milliseconds that the best may take.
        repeats: Number of calls.
        row: Row of the page's table of speeds and the benchmark that measures it, if it has one.
    """
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
    if row is not None:
        record("speed", row[0], [f"{best:.3g} ms, {median:.3g} ms", f"`{row[1]}`"])
    return best
