"""Recordings that commands read, and their shared options."""

from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from coview.arguments import check_least, site_file

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.frame import Frame, Recording


@dataclass(frozen=True)
class Opening:
    """Options for opening a recording."""

    layout: str | None = None
    """folder, hdf5, rosbag, foxglove, pcap, kitti, kitti-tracking, openlabel, dair, opv2v, v2xset,
    v2xreal, rcooper, nuscenes, argoverse or sustech."""
    poses: Path | None = None
    """File of sensor poses by name, for layout folder; the folder's own poses.json when left
    out."""
    inverted: bool = False
    """Take the poses as world to sensor (extrinsics) instead of sensor to world."""
    site: str | None = None
    """Name or file of the site, for hdf5 files that show no built-in one."""
    drop_invalid: bool = False
    """Leave out, and count, invalid objects of hdf5 (NaN, no size, kilometres away)."""

    @property
    def files(self) -> list[Path]:
        """Files that are read in addition to the recording: poses and site, if given."""
        poses = [self.poses] if self.poses else []
        return [*poses, *site_file(self.site)]

    @contextmanager
    def open(self, path: Path) -> "Iterator[Recording]":
        """Open a recording for a block, and close it afterwards.

        path: file or folder. Raises the errors of `toolkit.datasets.recordings.open_recording`,
        with the option that helps."""
        from toolkit.datasets.published_layout import InvalidObjects
        from toolkit.datasets.recordings import open_recording
        from toolkit.datasets.stored_site import UnknownSite
        from toolkit.sites import BUILT_IN
        from toolkit.sites.files import load_site

        if str(path) in BUILT_IN and not path.exists():
            raise ValueError(
                f"{path} is a site, no recording: make one with coview simulate {path} --out "
                f"{path}.hdf5"
            )
        site = load_site(self.site) if self.site else None
        try:
            recording = open_recording(
                path,
                self.layout,
                poses=self.poses,
                inverted=self.inverted,
                site=site,
                drop_invalid=self.drop_invalid,
            )
        except UnknownSite as error:
            raise ValueError(
                f"{path} does not say which site it shows, and shows no built-in one: give --site"
            ) from error
        try:
            yield recording
        except InvalidObjects as error:
            raise ValueError(f"{error}: pass --drop-invalid") from error
        finally:
            close = getattr(recording, "close", None)
            if close is not None:
                close()


def count_passing(
    frames: "Iterable[Frame]", problems: dict[str, int], progress: Callable[[int], None]
) -> "Iterator[Frame]":
    """Yield frames, report progress, and add up what reading left out.

    problems: number of objects left out by kind of problem, added to in place; progress: function
    that is called with the number of frames so far."""
    from toolkit.datasets.problem_kinds import add_problem

    for done, frame in enumerate(frames, 1):
        for kind, number in frame.problems.items():
            add_problem(problems, kind, number)
        progress(done)
        yield frame


@contextmanager
def open_recording(
    path: Path, site: str | None, *, drop_invalid: bool = False
) -> "Iterator[CoopDataset]":
    """Open a recording of a known site for a block.

    site: name or file of the site, None if the recording shows it; drop_invalid: True to leave out
    invalid objects. Raises ValueError for a recording of an unknown site."""
    with Opening(site=site, drop_invalid=drop_invalid).open(path) as recording:
        if recording.site is None:
            raise ValueError(
                f"{path} holds recorded clouds of an unknown site: give a recording of coview "
                "simulate, or take coview evaluate, which needs no site"
            )
        yield cast("CoopDataset", recording)


def frame_count(recording: Sized, frames: int | None) -> int:
    """Return the number of frames to use of a recording, at most all.

    frames: number that was asked for, None for all. Raises ValueError below 1."""
    check_least("--frames", value=frames, minimum=1, remedy="leave it out for all")
    return len(recording) if frames is None else min(frames, len(recording))
