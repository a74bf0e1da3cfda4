"""Layout of recordings: its name, and the functions that read and write it."""

import itertools
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from toolkit.frame import Frame, Recording
from toolkit.runtime.writing import writing_folder


@dataclass(frozen=True)
class Layout:
    """File layout of recordings.

    Attributes:
        name: its name.
        module: name of the module with its functions.
        reader: name of the function that makes a recording from a path.
        writer: name of the function that writes frames at a path, None for a layout that is only
            read.
        file: True if it writes one file instead of a folder.
    """

    name: str
    module: str
    reader: str
    writer: str | None = None
    file: bool = False

    @property
    def open(self) -> Callable[..., Recording]:
        """Function that makes a recording from a path."""
        return getattr(import_module(self.module), self.reader)

    @property
    def write(self) -> Callable[[Iterable[Frame], Path], int]:
        """Function that writes frames at a path and returns their number.

        A folder appears only when it is complete.
        Raises ValueError for a read-only layout."""
        if self.writer is None:
            raise ValueError(f"layout {self.name} is only read: write another, such as folder")
        writer = getattr(import_module(self.module), self.writer)

        def write_whole(frames: Iterable[Frame], path: Path) -> int:
            """Write all frames or nothing at a path; return their number."""
            numbers = itertools.count()
            # each frame that the writer takes uses up a number: the next one is how many it took
            counted_frames = (frame for frame, _ in zip(frames, numbers, strict=False))
            with nullcontext(path) if self.file else writing_folder(path) as unfinished:
                writer(counted_frames, unfinished)
            return next(numbers)

        return write_whole
