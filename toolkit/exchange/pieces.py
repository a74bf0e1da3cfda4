"""Endless output in files of a limited time.

Each file is written whole, so that all files but the last are complete whatever happens to the
process: those formats that are one document, such as OpenLABEL, hold no more than one file's time
in memory. Files are numbered on from those that are there."""

import re
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import find_standard, open_writers

_DIGITS = 6
_NUMBER = re.compile(r"\.?(\d{6,})")  # files, and hidden ones that a killed process left


class PieceWriter:
    """Writer of several formats, each in a folder with a file for every stretch of time.

    Args:
        folders: Folder of each standard by its name.
        piece_s: Time of a file (s).
        origin: Place on earth of the world frame, for formats that need it.
        asn1: Folder of the ASN.1 modules for cpm.

    Raises:
        ValueError: A name is unknown, a place is missing, modules are missing or wrong, or the time
            is not above 0.
        ImportError: A package is missing.
    """

    def __init__(
        self,
        folders: Mapping[str, Path],
        *,
        piece_s: float,
        origin: GeoOrigin | None = None,
        asn1: Path | None = None,
    ) -> None:
        """Check the formats; files are opened with the first instant.

        folders: folder of each format by its name; piece_s: time (s) that a file holds; origin:
        place on earth of the world's origin; asn1: folder of ASN.1 modules. Raises ValueError if a
        format needs them."""
        if not piece_s > 0:
            raise ValueError(f"a file must hold more than 0 s, got {piece_s:g}")
        for name in folders:
            standard = find_standard(name)
            standard.check_packages()
            if standard.needs_place and origin is None:
                raise ValueError(f"{name} needs the place on earth of the origin: give it")
            standard.check_asn1(asn1)
        self._folders = dict(folders)
        self._piece_s = piece_s
        self._origin = origin
        self._asn1 = asn1
        self._stack = ExitStack()  # closes the open files
        self._write: Callable[[Instant], None] | None = None  # None without open files
        self._end_s = 0.0  # time from which new files are needed

    @property
    def takes_clouds(self) -> bool:
        """True if a format holds clouds."""
        return any(find_standard(name).takes_clouds for name in self._folders)

    def write(self, instant: Instant) -> None:
        """Write an instant, in new files if those before hold `piece_s`."""
        if self._write is None or instant.time_s >= self._end_s:
            self.close()
            files = {name: next_piece_path(folder, name) for name, folder in self._folders.items()}
            self._write = self._stack.enter_context(
                open_writers(files, origin=self._origin, asn1=self._asn1)
            )
            self._end_s = instant.time_s + self._piece_s
        self._write(instant)

    def close(self) -> None:
        """Complete the open files."""
        self._write = None
        self._stack.close()


def next_piece_path(folder: Path, standard_name: str) -> Path:
    """Return the path of the file after the last one of a folder, counted from 000000.

    Files that a killed process left unfinished keep their numbers, too. standard_name: name of a
    format in `STANDARDS`, which gives the file's ending."""
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    matches = [_NUMBER.match(name) for name in names]
    numbers = [int(match[1]) for match in matches if match is not None]
    number = max(numbers, default=-1) + 1
    ending = find_standard(standard_name).ending
    return folder / f"{number:0{_DIGITS}d}{ending}"
