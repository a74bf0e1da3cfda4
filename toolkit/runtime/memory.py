"""What becomes of memory that arrays leave: kept for the next ones, rather than handed back to the system."""

from __future__ import annotations

import ctypes
import os
from functools import lru_cache

LARGEST_KEPT = 32 << 20  # bytes; the C library takes larger blocks from the system whatever it is asked
_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # of mallopt(3)
_NEVER = 2**31 - 1  # bytes at the end of the heap that are handed back, as far as an int goes
_OWN_SETTINGS = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES")


@lru_cache(maxsize=1)
def keep_freed_memory() -> bool:
    """Let arrays of up to `LARGEST_KEPT` bytes lie where others lay before, for the rest of this process; whether that
    could be arranged.

    The GNU C library hands back what is freed at the end of its heap, and the system clears every page of it before it
    can be used again; a network whose maps come and go spends a third of its time on that. What a process has used at
    most then stays with it. Nothing is changed under another C library, or where the environment says how to allocate
    (MALLOC_TRIM_THRESHOLD_, MALLOC_MMAP_THRESHOLD_, GLIBC_TUNABLES).
    """
    if any(name in os.environ for name in _OWN_SETTINGS):
        return False
    mallopt = getattr(_c_library(), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, LARGEST_KEPT)) and bool(mallopt(_TRIM_THRESHOLD, _NEVER))


def _c_library() -> object:
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):  # no handle of the program itself, as on Windows
        return None
