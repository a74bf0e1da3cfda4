"""Recordings of named frames, read on demand."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from toolkit.datasets.problem_kinds import STRAY, add_problem
from toolkit.frame import DisplayedRecording, Frame, Frames, RecordingView
from toolkit.sites.site import Site


@dataclass(frozen=True)
class Listing(DisplayedRecording):
    """A recording of named frames, read on demand.

    The first frame counts in its problems the labels without a cloud, and what was noted.

    Attributes:
        names: names of the frames.
        load: reads a frame by its name.
        path: path of the recording, None if unknown.
        site: the site, None if unknown.
        labelled: names, times or tokens that labels refer to, also of missing clouds.
        known: names, times or tokens that have a cloud, `names` if None.
        noted: problems of the whole recording, by kind.
    """

    names: tuple[str, ...]
    load: Callable[[str], Frame]
    path: Path | None = None
    site: Site | None = None
    labelled: Collection[str] = ()
    known: Collection[str] | None = None
    noted: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self.names)))

    def __getitem__(self, index: int) -> Frame:
        """Read the frame of an index; the first one also gets the problems of the recording."""
        frame = self.load(self.names[index])
        is_first = index % len(self.names) == 0  # the index may count from the end
        if not is_first:
            return frame
        problems = dict(frame.problems)
        # labels without a cloud, and what the reader noted
        for kind, count in {STRAY: len(self.strays), **self.noted}.items():
            add_problem(problems, kind, count)
        return replace(frame, problems=problems) if problems != frame.problems else frame

    @cached_property
    def strays(self) -> tuple[str, ...]:
        """Names, times or tokens that labels refer to and that have no cloud, each once."""
        names = set(self.names if self.known is None else self.known)
        return tuple(name for name in dict.fromkeys(self.labelled) if name not in names)

    def describe_strays(self) -> str:
        """Return in one line how many labels have no cloud, with an example of each; empty without
        any."""
        if not self.strays:
            return ""
        count = len(self.strays)
        total = len(set(self.labelled))
        example = next(iter(self.names if self.known is None else self.known), "")
        return (
            f"{count} of the {total} {STRAY}, such as {self.strays[0][:60]!r}, where clouds have "
            f"{example[:60]!r}"
        )


def check_labels(recording: Frames, frames: int | None = None) -> None:
    """Raise ValueError if nothing can be scored.

    This is so if no label has a cloud, or if the first frames of an unknown site have no label.
    frames: number of first frames to look at, None for all."""
    source = recording  # as it was opened, under all views
    while isinstance(source, RecordingView):
        source = source.recording
    if (
        isinstance(source, Listing)
        and source.strays
        and len(source.strays) == len(set(source.labelled))
    ):
        strays = source.describe_strays()
        raise ValueError(f"no label can be used: {strays}; name both alike, times in the same unit")
    count = len(recording) if frames is None else frames
    first_frames = (recording[index] for index in range(count))
    if getattr(recording, "site", None) is None and not any(
        len(frame.objects) or len(frame.others.boxes) for frame in first_frames
    ):
        remedy = "take coview detect, or give labels, such as the labels.json of layout folder"
        raise ValueError(f"the recording has no label, so nothing can be scored: {remedy}")
