"""The digest of a job's source: every module that it runs counts, no other does."""

import shutil
from pathlib import Path

import pytest

from toolkit.runtime.cache import (
    PACKAGES,
    SOURCE_ROOT,
    code_digest,
    digest_of_source,
    import_closure,
)

JOBS = {
    "rendering": "placement_env.fidelity.renders",
    "visibility": "placement_env.fidelity.seeing",
    "detection": "placement_env.fidelity.detector",
    "networks": "models.detector_loading",
}


def _ignore(_, names):
    return [name for name in names if "." in name and not name.endswith((".py", ".toml"))]


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    top = tmp_path_factory.mktemp("source")
    for package in PACKAGES:
        shutil.copytree(SOURCE_ROOT / package, top / package, ignore=_ignore)
    return top


def touch(paths):
    """Change files, and return what was in each."""
    sources = {path: path.read_bytes() for path in paths}
    for path, source in sources.items():
        path.write_bytes(source + b"\n# touched\n")
    return sources


def restore(sources):
    for path, source in sources.items():
        path.write_bytes(source)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_every_module_that_the_job_runs_counts_and_no_other(tree, job):
    closure, _ = import_closure((job,), tree)
    before = digest_of_source((job,), tree)
    assert before == digest_of_source((job,), SOURCE_ROOT)
    others = {path for package in PACKAGES for path in (tree / package).rglob("*.py")} - set(
        closure.values()
    )
    assert len(closure) > 10
    assert len(others) > 20
    for path in closure.values():  # one by one, since each must count
        sources = touch([path])
        assert digest_of_source((job,), tree) != before, path
        restore(sources)
    sources = touch(others)  # at once, since none may count
    assert digest_of_source((job,), tree) == before
    restore(sources)
    assert digest_of_source((job,), tree) == before


@pytest.mark.parametrize(
    ("job", "module"),
    [
        *(
            ("rendering", "toolkit.rendering.static_scene"),
            ("rendering", "models.training.packing"),
        ),
        *(("rendering", "toolkit.sites.site"), ("visibility", "placement_env.fidelity.occlusion")),
        *(("visibility", "placement_env.fidelity.traffic"), ("visibility", "toolkit.sites.site")),
        *(("detection", "toolkit.detection.view"), ("detection", "toolkit.detection.metrics")),
        *(("detection", "placement_env.fidelity.traffic"), ("networks", "models.network.voxelnet")),
        ("networks", "models.network.sparse"),
    ],
)
def test_a_job_runs_what_its_figures_depend_on(job, module):
    assert module in import_closure((JOBS[job],))[0]


@pytest.mark.parametrize(
    ("module", "old", "new", "jobs"),
    [
        (
            "toolkit/sites/site.py",
            "HYBRID_RADIUS_M = 20.0",
            "HYBRID_RADIUS_M = 10.0",
            ["rendering", "visibility", "detection"],
        ),
        (
            "placement_env/fidelity/traffic.py",
            "(VEHICLE,)",
            "(0, 3)",
            ["rendering", "visibility", "detection"],
        ),
        (
            "toolkit/bodies/cars.toml",
            "[0.02, 0.44]",
            "[0.02, 0.45]",
            ["rendering", "visibility", "detection"],
        ),
    ],
)
def test_changes_that_were_served_stale_figures_count(tree, module, old, new, jobs):
    path = tree / module
    source = path.read_text()
    assert old in source
    before = [digest_of_source((JOBS[job],), tree) for job in jobs]
    path.write_text(source.replace(old, new))
    after = [digest_of_source((JOBS[job],), tree) for job in jobs]
    path.write_text(source)
    assert all(a != b for a, b in zip(after, before, strict=True))


def package(top: Path, **files: str) -> Path:
    for name, source in files.items():
        path = top / "toolkit" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
    return top


FACE = """
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from toolkit.b import thing as thing
    from toolkit.c import other
else:
    import toolkit.d
"""
STUB = (
    "from .b import thing as thing\nfrom .c import other as other\nfrom .e import named as named\n"
)


@pytest.mark.parametrize(
    ("source", "runs"),
    [
        *(
            ("", ""),
            ("import toolkit.b", "b"),
            ("from toolkit import b", "b"),
            ("from . import b", "b"),
        ),
        *(
            ("from .b import thing", "b"),
            ("from toolkit import thing", "b"),
            ("from toolkit import other", "c"),
        ),
        *(("from toolkit import named", "e"), ("from toolkit import *", "bcde")),
        ("def f():\n    if True:\n        from toolkit.c import x", "c"),
        (
            (
                "try:\n    import toolkit.b\nexcept ImportError:\n    import "
                "toolkit.c\nfinally:\n    import toolkit.e"
            ),
            "bce",
        ),
        ("match 1:\n    case 1:\n        import toolkit.b", "b"),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import toolkit.b", ""),
        (
            (
                "import typing\nif typing.TYPE_CHECKING:\n    import toolkit.b\nelse:\n    import "
                "toolkit.c"
            ),
            "c",
        ),
        *(
            ("import os, json.decoder\nimport numpy.linalg", ""),
            ("'''from toolkit import b'''", ""),
        ),
    ],
)
def test_what_is_imported_is_followed_as_python_would(tmp_path, source, runs):
    top = package(tmp_path, __init__=FACE, a=source, b="", c="", d="", e="")
    (top / "toolkit" / "__init__.pyi").write_text(STUB)
    files, libraries = import_closure(("toolkit.a",), tmp_path)
    assert set(files) == {
        "toolkit",
        "toolkit.a",
        "toolkit.d",
        *(f"toolkit.{each}" for each in runs),
    }
    assert libraries == ({"numpy"} if "numpy" in source else set())


def test_modules_of_the_user_s_count_by_their_file():
    own, detection = __name__, JOBS["detection"]
    assert code_digest(detection, own) != code_digest(detection)
    assert import_closure((own,))[0][own] == Path(__file__)


def test_it_is_computed_once(fail):
    first = code_digest("toolkit.boxes")
    fail(Path, "read_bytes")
    assert code_digest("toolkit.boxes") == first
