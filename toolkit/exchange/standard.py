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
        writer: module and class of its writer, which is made from a path, a `GeoOrigin` if it needs
            a place, and a folder if it needs ASN.1 modules.
        ending: ending of its file, "" if it writes a folder.
        packages: pairs of a module that writing imports and the package that has it.
        needs_time: True if every instant must have a time.
        needs_place: True if the world frame's place on earth must be known.
        needs_asn1: True if the message's ASN.1 modules must be given.
        takes_clouds: True if it holds clouds too, or the names of their sensors.
        extra: extra of coview that brings the packages.
    """

    name: str
    writer: str
    ending: str
    packages: tuple[tuple[str, str], ...] = ()
    needs_time: bool = True
    needs_place: bool = False
    needs_asn1: bool = False
    takes_clouds: bool = False
    extra: str = "exchange"

    def check_packages(self) -> None:
        """Raise ImportError for a missing package."""
        missing_packages = [
            package for module, package in self.packages if find_spec(module) is None
        ]
        if missing_packages:
            raise ImportError(
                f"writing {self.name} needs {', '.join(missing_packages)}: pip install "
                f"coview[{self.extra}]"
            )

    def check_asn1(self, asn1: Path | None) -> None:
        """Raise OSError or ValueError for ASN.1 modules that are needed, and missing or wrong.

        asn1: their folder."""
        if self.needs_asn1:
            from toolkit.exchange.collective_perception import check_cpm_modules

            check_cpm_modules(self._require_asn1(asn1))

    def make(self, path: Path, origin: GeoOrigin | None, asn1: Path | None) -> Writer:
        """Make the writer of a file.

        origin: the world frame's place on earth, None if unknown; asn1: folder of ASN.1 modules.
        Raises ValueError for an unknown place or no modules if the format needs them."""
        if self.needs_place and origin is None:
            raise ValueError(
                f"{self.name} needs the recording's place on earth: give the latitude and "
                "longitude of its origin"
            )
        arguments: list[GeoOrigin | Path | None] = [origin] if self.needs_place else []
        if self.needs_asn1:
            arguments.append(self._require_asn1(asn1))
        module, class_name = self.writer.split(":")
        writer_class: Callable[..., Writer] = getattr(import_module(module), class_name)
        return writer_class(path, *arguments)

    def _require_asn1(self, asn1: Path | None) -> Path:
        """Return the folder of ASN.1 modules. Raises ValueError if it is not given."""
        if asn1 is None:
            raise ValueError(f"{self.name} needs ETSI's ASN.1 modules: give their folder")
        return asn1
