"""Memory that is kept: the system clears no pages for arrays that come and go."""

import os
import platform
import subprocess
import sys

import pytest

from toolkit.runtime import memory
from toolkit.runtime.memory import LARGEST_KEPT, keep_freed_memory

COUNTS = """
import resource, sys
import numpy as np
from toolkit.runtime.memory import keep_freed_memory

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
    clean = {name: value for name, value in os.environ.items() if name not in memory._OWN_SETTINGS}
    done = subprocess.run(
        [sys.executable, "-c", COUNTS, how],
        env=clean | environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
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


def test_what_the_environment_says_wins():
    assert counted("keep", **OWN)[0] == "False"


def test_it_is_arranged_once(monkeypatch):
    asked = []

    def mallopt(*what):
        asked.append(what)
        return 1

    library = type("Library", (), {"mallopt": staticmethod(mallopt)})
    monkeypatch.setattr(memory, "_c_library", lambda: library)
    for name in memory._OWN_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    keep_freed_memory.cache_clear()
    assert keep_freed_memory()
    assert keep_freed_memory()
    assert asked == [(-3, LARGEST_KEPT), (-1, 2**31 - 1)]
    keep_freed_memory.cache_clear()


@pytest.mark.parametrize("library", [None, object(), type("Refuses", (), {"mallopt": staticmethod(lambda *_: 0)})])
def test_without_it_nothing_happens(monkeypatch, library):
    monkeypatch.setattr(memory, "_c_library", lambda: library)
    for name in memory._OWN_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    keep_freed_memory.cache_clear()
    assert keep_freed_memory() is False
    keep_freed_memory.cache_clear()
