"""`python -m toolkit.sites` makes the packaged files of the built-in sites again."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from toolkit.sites import BUILT_IN
from toolkit.sites.files import save_site


def main() -> None:
    """Build every built-in site and write its JSON beside this file."""
    for name in BUILT_IN:
        path = Path(__file__).parent / f"{name}.json"
        save_site(import_module(f"toolkit.sites.{name}").build(), path)
        print(path)


if __name__ == "__main__":
    main()
