"""What tests of every folder share: smaller limits, noted calls, errors of functions, missing
packages, variables of the environment, a folder to work in, the browser that pages are opened in, a
Ray cluster of two nodes, syntax trees of the packages, and hypothesis without a clock."""

import ast
import gc
import importlib
import os
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import settings

from toolkit.plots import fonts

settings.register_profile("any machine", deadline=None)  # a busy one is no fault
settings.load_profile("any machine")
# figures in tests are those of exact numbers, whatever the processor is quickest with
os.environ.setdefault("COVIEW_NUMBERS", "float32")

ROOT = Path(__file__).parents[1]
FLOORS = ("toolkit", "models", "placement_env", "coview")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.hookimpl(tryfirst=True)  # before slow tests are left out
def pytest_collection_modifyitems(items):
    """Make the cases of tests that are marked `one_in(n)` slow, but the first of each n."""
    cases = Counter()
    for item in items:
        mark = item.get_closest_marker("one_in")
        if mark is None:
            continue
        (n,) = mark.args
        name = item.nodeid.partition("[")[0]
        if cases[name] % n:
            item.add_marker(pytest.mark.slow)
        cases[name] += 1


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Search for garbage only after collection, and never again among the modules and tests."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


def pytest_unconfigure():
    """Let libraries tidy up at the end."""
    gc.unfreeze()


@pytest.fixture
def limits(monkeypatch):
    """Give constants of a module other values, so that small inputs reach a limit:
    `limits(module, MAX_CELLS=750)`. Only numbers may change: code stays as it is."""

    def set_limits(module, **values):
        module = importlib.import_module(module) if isinstance(module, str) else module
        for name, value in values.items():
            assert isinstance(getattr(module, name), int | float), f"{name} is no number"
            monkeypatch.setattr(module, name, value)

    return set_limits


class Call(NamedTuple):
    """Arguments of one call."""

    args: tuple[Any, ...]
    named: dict[str, Any]


@pytest.fixture
def spy(monkeypatch):
    """Note the calls of a function, which works as before: `calls = spy(module, "name")`."""

    def note_calls(owner, name):
        owner = importlib.import_module(owner) if isinstance(owner, str) else owner
        function, calls = getattr(owner, name), []

        def noted(*args, **named):
            calls.append(Call(args, named))
            return function(*args, **named)

        monkeypatch.setattr(owner, name, noted)
        return calls

    return note_calls


@pytest.fixture
def fail():
    """Let a function raise an error instead, because a disk is full or as nothing may call it:
    `fail(module, "name", OSError())`. The patch that comes back has `undo`."""
    patches = []

    def replace_by_error(owner, name, error=None):
        owner = importlib.import_module(owner) if isinstance(owner, str) else owner

        def raising(*_, **__):
            raise error or AssertionError(f"{name} was called")

        patch = pytest.MonkeyPatch()
        patches.append(patch)
        patch.setattr(owner, name, raising)
        return patch

    yield replace_by_error
    for patch in patches:
        patch.undo()


@pytest.fixture
def without_packages(monkeypatch):
    """Hide installed packages from `import` and `find_spec`: `without_packages("ray")`."""

    def hide(*names):
        for name in names:
            monkeypatch.setitem(sys.modules, name, None)

    return hide


@pytest.fixture
def environment(monkeypatch):
    """Set variables of the environment, None to remove one: `environment(PATH="")`."""

    def set_variables(**values):
        for name, value in values.items():
            if value is None:
                monkeypatch.delenv(name, raising=False)
            else:
                monkeypatch.setenv(name, value)

    return set_variables


@pytest.fixture
def work_in(monkeypatch):
    """Change to a folder whose modules can be imported, as `python` does: `work_in(folder)`."""

    def change(folder):
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(str(folder))
        return folder

    return change


@pytest.fixture
def system_fonts(monkeypatch):
    """Say which files of fonts this computer has: `system_fonts(path, other_path)`."""

    def set_fonts(*files):
        monkeypatch.setattr(fonts, "list_system_fonts", lambda: files)
        fonts.cover_letters.cache_clear()

    yield set_fonts
    fonts.cover_letters.cache_clear()


@pytest.fixture
def bfloat16_library(monkeypatch):
    """Say which library this machine is quickest with at bfloat16, None for none:
    `bfloat16_library("torch")`."""

    def set_library(name):
        monkeypatch.setattr("models.detector.find_bfloat16_library", lambda device: name)

    return set_library


@pytest.fixture(scope="session")
def floor_trees():
    """Syntax trees of the files of each floor, by path from the root of the project."""
    paths = {floor: sorted((ROOT / floor).rglob("*.py")) for floor in FLOORS}
    return {
        floor: {path.relative_to(ROOT): ast.parse(path.read_text("utf-8")) for path in files}
        for floor, files in paths.items()
    }


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.fail(
            "pages are tested in Chromium, which is not here: run make, or apt-get install chromium"
        )
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def two_nodes():
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 100_000_000}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    yield cluster, cluster.add_node(**node)
    ray.shutdown()  # a cluster cannot end while this process is part of it
    cluster.shutdown()
