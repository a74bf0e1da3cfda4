"""Freed memory stays with the process where the C library can keep it, and goes back when asked."""

import os
import platform
import subprocess
import sys
from types import SimpleNamespace

import pytest

from toolkit.runtime.allocation import (
    MALLOC_SETTINGS,
    MAX_KEPT_BYTES,
    keep_freed_memory,
    return_freed_memory,
    tune_allocation,
)

COUNTS = """
import resource, sys
import numpy as np
from toolkit.runtime.allocation import keep_freed_memory

def faults(count, size):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(count):
        several = [np.ones(size, np.uint8) for _ in range(4)]
        del several
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

kept = keep_freed_memory() if sys.argv[1] == "keep" else None
faults(2, 12 << 20)
print(kept, faults(20, 12 << 20))
"""
OWN = {"MALLOC_TRIM_THRESHOLD_": "131072"}


def counted(how, **environment):
    clean = {name: value for name, value in os.environ.items() if name not in MALLOC_SETTINGS}
    command = [sys.executable, "-c", COUNTS, how]
    done = subprocess.run(
        command, env=clean | environment, capture_output=True, text=True, check=True, timeout=60
    )
    kept, faults = done.stdout.split()
    return kept, int(faults)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_arrays_come_to_lie_where_others_lay():
    kept, few = counted("keep")
    _, many = counted("leave")
    assert kept == "True"
    assert many > 1000
    assert few < many / 20


def test_the_environment_wins():
    assert counted("keep", **OWN)[0] == "False"


@pytest.mark.parametrize(
    "library", [None, object(), type("Refuses", (), {"mallopt": staticmethod(lambda *_: 0)}), "c"]
)
def test_freed_memory_is_kept_where_the_library_can(library):
    asked = []

    def mallopt(*what):
        asked.append(what)
        return 1

    there = library == "c"
    library = type("Library", (), {"mallopt": staticmethod(mallopt)}) if there else library
    assert tune_allocation(library, {"HOME": "/"}) == there
    assert asked == [(-3, MAX_KEPT_BYTES), (-1, 2**31 - 1)] * there
    for name in MALLOC_SETTINGS:
        assert not tune_allocation(library, {"HOME": "/", name: "1"})
    assert len(asked) == 2 * there


def test_the_c_library_is_asked_once():
    keep_freed_memory()
    before = keep_freed_memory.cache_info().misses
    keep_freed_memory()
    assert keep_freed_memory.cache_info().misses == before


def test_freed_memory_goes_back_where_the_c_library_can():
    asked = []
    for library in (SimpleNamespace(malloc_trim=asked.append), SimpleNamespace(), None):
        return_freed_memory(library)
    assert asked == [0]
