"""Memory that the C library keeps for new arrays, or returns to the system."""

import ctypes
import os
from collections.abc import Iterable
from functools import lru_cache

MAX_KEPT_BYTES = 32 << 20  # the C library always takes larger blocks from the system
_MMAP_THRESHOLD = -3  # option of mallopt(3)
_TRIM_THRESHOLD = -1  # option of mallopt(3)
_MAX_TRIM_BYTES = 2**31 - 1  # the largest int, so that the end of the heap is never returned
MALLOC_SETTINGS = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES")


@lru_cache(maxsize=1)
def keep_freed_memory() -> bool:
    """Let new arrays of up to `MAX_KEPT_BYTES` bytes reuse the memory of old ones; return success.

    The GNU C library returns freed memory at the end of its heap to the system, which clears every
    page before it is used again: a third of the time of a network that allocates and frees maps.
    The process then keeps its peak memory. Nothing changes under another C library, or if the
    environment configures allocation."""
    return tune_allocation(_c_library(), os.environ)


def tune_allocation(library: object, environment: Iterable[str]) -> bool:
    """Let a C library keep freed blocks of up to `MAX_KEPT_BYTES` bytes; return success.

    library: C library, None without one; environment: names of the environment's variables. One of
    `MALLOC_SETTINGS` among them changes allocation already, so nothing is done."""
    mallopt = getattr(library, "mallopt", None)
    if mallopt is None or not set(MALLOC_SETTINGS).isdisjoint(environment):
        return False
    return bool(mallopt(_MMAP_THRESHOLD, MAX_KEPT_BYTES)) and bool(
        mallopt(_TRIM_THRESHOLD, _MAX_TRIM_BYTES)
    )


def return_freed_memory(library: object = None) -> None:
    """Return freed memory to the system, after a job that took much.

    Does nothing under another C library. library: C library, None for this process's."""
    getattr(library or _c_library(), "malloc_trim", bool)(0)


def _c_library() -> object:
    """C library of this process, None if it cannot be reached."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):  # no handle of the program itself, as on Windows
        return None
