"""Studies: commands whose code is in a clone of coview, not in its wheel."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

PACKAGE = "examples.studies"


def import_study(module: str) -> ModuleType:
    """Import a module of the studies.

    Raises ImportError if coview was installed from a wheel, and if another package hides the
    studies."""
    home = Path(__file__).resolve().parents[1]  # the root of the clone
    folder = home.joinpath(*PACKAGE.split("."))
    if not folder.is_dir():
        raise ImportError(
            "reproduce and stress are studies, which are in a clone of coview and not in its "
            "wheel: clone the repository, run make setup in it, and start them there"
        )
    try:
        spec = find_spec(PACKAGE)
    except ModuleNotFoundError:  # a module, not a package, has the parent's name
        spec = None
    if spec is None or Path(str(spec.origin)).resolve().parent != folder:
        raise ImportError(
            f"another package named {PACKAGE.partition('.')[0]} hides the studies in {folder}: "
            "uninstall it, or take it out of PYTHONPATH"
        )
    return import_module(f"{PACKAGE}.{module}")
