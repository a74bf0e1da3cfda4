"""Format of other programs: its name, its packages, and the writer that serves it."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.writer import Writer


@dataclass(frozen=True)
class Standard:
    """Format of other programs that a writer serves.

    Attributes:
        name: its name.
        writer: module and class of its writer, which is made from a path, and a `GeoOrigin` if it
            needs a place.
        ending: ending of its file, "" if it writes a folder.
        packages: pairs of a module that writing imports and the package that has it.
        needs_time: True if every instant must have a time.
        needs_place: True if the world frame's place on earth must be known.
        takes_clouds: True if it holds clouds too.
    """

    name: str
    writer: str
    ending: str
    packages: tuple[tuple[str, str], ...] = ()
    needs_time: bool = True
    needs_place: bool = False
    takes_clouds: bool = False

    def check_packages(self) -> None:
        """Raise ImportError for a missing package."""
        missing_packages = [
            package for module, package in self.packages if find_spec(module) is None
        ]
        if missing_packages:
            raise ImportError(
                f"writing {self.name} needs {', '.join(missing_packages)}: pip install "
                "coview[exchange]"
            )

    def make(self, path: Path, origin: GeoOrigin | None) -> Writer:
        """Make the writer of a file.

        origin: the world frame's place on earth, None if unknown. Raises ValueError for an unknown
        place if the format needs it."""
        if self.needs_place and origin is None:
            raise ValueError(
                f"{self.name} needs the recording's place on earth: give the latitude and "
                "longitude of its origin"
            )
        module, class_name = self.writer.split(":")
        writer_class: Callable[..., Writer] = getattr(import_module(module), class_name)
        return writer_class(path, origin) if self.needs_place else writer_class(path)
