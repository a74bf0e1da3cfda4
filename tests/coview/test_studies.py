"""Commands of studies: started from a clone, refused in one sentence elsewhere."""

import sys

import pytest

from coview import studies
from coview.main import STUDIES, command


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_a_clone_has_the_studies(name):
    assert command(name).__module__.startswith("examples.studies.")


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """Coview in a folder without examples."""
    monkeypatch.setattr(studies, "__file__", str(tmp_path / "coview" / "studies.py"))
    return tmp_path


@pytest.mark.parametrize("arguments", [("stress", "a.hdf5"), ("reproduce", "--help")])
def test_a_wheel_names_the_remedy(arguments, wheel, run):
    code, printed, err = run(*arguments)
    assert (code, printed) == (3, "")
    assert err.startswith(
        "coview: reproduce and stress are studies, which are in a clone of coview"
    )
    assert "make setup" in err


def test_a_wheel_refuses_unknown_options_as_before(wheel, run):
    assert run("--nothing")[0] == 2


@pytest.mark.parametrize("name", ["examples.py", "examples/__init__.py"])
def test_a_package_that_hides_the_studies_is_named(name, tmp_path, work_in, monkeypatch, run):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("")
    work_in(tmp_path)
    for module in [module for module in sys.modules if module.partition(".")[0] == "examples"]:
        monkeypatch.delitem(sys.modules, module)
    code, _, err = run("stress", "a.hdf5")
    assert code == 3
    assert "another package named examples hides the studies" in err
