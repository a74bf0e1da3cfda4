"""Files of a folder in their natural order."""

import re
from pathlib import Path

# a run of digits that is not a part of the decimals of a number
_WHOLE_NUMBER = re.compile(r"(?<![0-9])(?<![0-9]\.)([0-9]{1,300})")
MACOS_FOLDER = "__MACOSX"
BAG_ENDINGS = (".bag", ".mcap", ".db3")
PCAP_ENDINGS = (".pcap", ".pcapng")
# endings of cloud files; among several files of one name the first ending counts
ENDINGS = (".pcd", ".bin", ".ply", ".npy", ".npz", ".feather", ".xyz", ".csv", ".las", ".laz")
NameOrder = tuple[tuple[str | int, ...], str]  # sort key of a name: its pieces, and the name itself


def list_files(folder: Path, pattern: str = "*", *, recursive: bool = False) -> list[Path]:
    """List the files and folders in a folder in `natural_order`, by glob pattern.

    Hidden ones are left out, and files that macOS adds to archives (`._NAME`)."""
    matches = folder.rglob(pattern) if recursive else folder.glob(pattern)
    files = [file for file in matches if not _is_hidden(file.relative_to(folder).parts)]
    return sorted(files, key=_path_order)


def natural_order(name: str) -> NameOrder:
    """Sort key of a name: numbers in it count as numbers, so that frame 2 comes before frame 10.

    Digits after a decimal point stay text, as they are compared from their left.

    >>> sorted(["10", "9", "1"], key=natural_order)
    ['1', '9', '10']
    >>> sorted(["7.5", "7.25", "007"], key=natural_order)
    ['007', '7.25', '7.5']
    >>> sorted(["scan2", "scan"], key=natural_order)
    ['scan', 'scan2']
    """
    # texts and numbers in turn, a text first; the name itself decides between 7 and 007. It is
    # apart from them, since it would meet the number of a longer name
    pieces = _WHOLE_NUMBER.split(name)
    key = (int(piece) if index % 2 else piece for index, piece in enumerate(pieces))
    return tuple(key), name


def _path_order(file: Path) -> tuple[NameOrder, ...]:
    """Sort key of a path by its parts; the ending of a file's name comes last."""
    folders = tuple(natural_order(part) for part in file.parts[:-1])
    return (*folders, natural_order(file.stem), ((file.suffix,), ""))


def _is_hidden(parts: tuple[str, ...]) -> bool:
    """True if a part of a path begins with a dot, or is a folder that macOS adds to archives."""
    return any(part.startswith(".") or part == MACOS_FOLDER for part in parts)


def list_bags(folder: Path) -> list[Path]:
    """List the files of ROS bags directly in a folder, in natural order."""
    return [file for file in list_files(folder) if file.suffix.lower() in BAG_ENDINGS]
