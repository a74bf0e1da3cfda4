import sys

import pytest

from toolkit.runtime.lazy import lazily


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of two modules on the path, none of them loaded."""
    folder = tmp_path / "a_lazy_package"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "one.py").write_text("def first():\n    return 1\nSECOND = 2\n")
    (folder / "broken.py").write_text("import a_module_that_is_not_installed\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder.name
    for name in [name for name in sys.modules if name.startswith(folder.name)]:
        del sys.modules[name]


def test_names_and_modules_load_when_they_are_asked_for(package):
    load, listed, offered = lazily(package, {"one": ("first", "SECOND"), "broken": ("third",)})
    assert listed() == offered == ["SECOND", "first", "third"]
    assert f"{package}.one" not in sys.modules
    assert load("first")() == 1
    assert load("SECOND") == 2
    assert load("one").first is load("first")


def test_what_is_not_offered_is_an_attribute_error(package):
    load, _, _ = lazily(package, {"one": ("first",)})
    for name in ("frist", "_private", "__wrapped__"):
        with pytest.raises(AttributeError, match=f"module '{package}' has no attribute '{name}'"):
            load(name)


def test_a_missing_dependency_is_named(package):
    load, _, _ = lazily(package, {"broken": ("third",)})
    with pytest.raises(ModuleNotFoundError, match="a_module_that_is_not_installed"):
        load("third")
