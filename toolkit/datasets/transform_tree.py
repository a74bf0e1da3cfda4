"""Coordinate frames over time, as the topics /tf and /tf_static of a ROS bag state them.

- A static transform holds at all times, whatever its stamp. A later one of the same frame replaces
  it from the time on at which it was recorded, as a listener would see it.
- The pose of a moving frame is interpolated between two transforms to one parent; before the first,
  after the last and while its parent changes, the pose is the nearest transform's. `gap_s` is how
  far away that is.
- A frame that both topics place is static: tf2 keeps one history for a frame.
- A transform that tf2 would not take is left out and counted: a quaternion not of length 1, numbers
  that are not finite, a frame without a name or in itself."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64, Pose
from toolkit.datasets.pose_files import quaternion_pose

MAX_LINKS = 64  # from a sensor's frame to the root; longer chains run in a circle
NS_PER_S = 10**9
MALFORMED = (
    "transforms that tf2 would not take: quaternion not of length 1, not finite, or of a frame "
    "in itself"
)
TWICE_PLACED = "frames that both /tf and /tf_static place, taken as static"


class TransformLink(NamedTuple):
    """One transform: child in parent.

    Attributes:
        child: name of the child frame.
        parent: name of the parent frame.
        parent_SE3_child: pose, None if it is malformed.
        stamp_ns: its time stamp.
        recorded_ns: time of its recording.
        is_static: True if it is of /tf_static and holds at all times.
    """

    child: str
    parent: str
    parent_SE3_child: Pose | None
    stamp_ns: int
    recorded_ns: int
    is_static: bool


class Placed(NamedTuple):
    """Pose of a frame in its root, the frame at the top of its chain of parents.

    gap_s: largest time (s) between the asked time and a transform used for it, along the chain."""

    root: str
    root_SE3_frame: Pose
    gap_s: float


@dataclass(frozen=True, eq=False)
class FrameHistory:
    """Transforms of one frame to its parents, by rising time.

    times_ns: time of each transform; parents: name of its parent; poses: parent_SE3_frame."""

    times_ns: Int64[np.ndarray, " n"]
    parents: tuple[str, ...]
    poses: Float64[np.ndarray, "n 4 4"]

    @staticmethod
    def from_links(by_time: Mapping[int, TransformLink]) -> "FrameHistory":
        """Make the history of one frame from its transforms by time (ns), in any order."""
        times = sorted(by_time)
        links = [by_time[time] for time in times]
        poses = np.stack(
            [link.parent_SE3_child for link in links if link.parent_SE3_child is not None]
        )
        return FrameHistory(np.array(times, np.int64), tuple(link.parent for link in links), poses)

    def last_before(self, time_ns: int) -> tuple[str, Pose]:
        """Return parent and pose of the last transform up to a time (ns).

        If all are later, it is the first one."""
        row = max(0, int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1)
        return self.parents[row], self.poses[row]

    def interpolate(self, time_ns: int) -> tuple[str, Pose, float]:
        """Return parent, pose and gap at a time (ns).

        The gap is the distance (s) to the nearest transform if there is no transform of this
        time."""
        later = int(np.searchsorted(self.times_ns, time_ns))
        if later < len(self.times_ns) and self.times_ns[later] == time_ns:
            return self.parents[later], self.poses[later], 0.0
        if 0 < later < len(self.times_ns) and self.parents[later - 1] == self.parents[later]:
            before, after = self.times_ns[later - 1 : later + 1].tolist()
            share = (time_ns - before) / (after - before)
            gap = min(time_ns - before, after - time_ns) / NS_PER_S
            return (
                self.parents[later],
                between(self.poses[later - 1], self.poses[later], share),
                gap,
            )
        row = max(0, later - 1)
        is_single = len(self.times_ns) == 1  # nothing else is known of the frame
        gap = 0.0 if is_single else abs(time_ns - int(self.times_ns[row])) / NS_PER_S
        return self.parents[row], self.poses[row], gap


@dataclass(frozen=True, eq=False)
class TransformTree:
    """Frames of coordinates and their parents.

    Attributes:
        static: frames of /tf_static, by the times at which their transforms were recorded.
        moving: frames of /tf, by the stamps of their transforms.
        problems: transforms left out, by kind."""

    static: Mapping[str, FrameHistory] = field(default_factory=dict)
    moving: Mapping[str, FrameHistory] = field(default_factory=dict)
    problems: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def from_links(links: Iterable[TransformLink]) -> "TransformTree":
        """Build the tree of all transforms of a bag, in the order of their recording."""
        static: dict[str, dict[int, TransformLink]] = {}
        moving: dict[str, dict[int, TransformLink]] = {}
        malformed = 0
        for link in links:
            if (
                link.parent_SE3_child is None
                or not link.child
                or not link.parent
                or link.child == link.parent
            ):
                malformed += 1
            elif link.is_static:
                static.setdefault(link.child, {})[link.recorded_ns] = link
            else:
                moving.setdefault(link.child, {})[link.stamp_ns or link.recorded_ns] = link
        twice = static.keys() & moving.keys()
        counted = {MALFORMED: malformed, TWICE_PLACED: len(twice)}
        return TransformTree(
            {child: FrameHistory.from_links(by_time) for child, by_time in static.items()},
            {
                child: FrameHistory.from_links(by_time)
                for child, by_time in moving.items()
                if child not in twice
            },
            {kind: count for kind, count in counted.items() if count},
        )

    def knows(self, frame: str) -> bool:
        """Return True for the name of a frame that some transform has as child or parent."""
        histories = (*self.static.values(), *self.moving.values())
        return (
            frame in self.static
            or frame in self.moving
            or any(frame in history.parents for history in histories)
        )

    def find(self, frame: str, stamp_ns: int, recorded_ns: int) -> Placed:
        """Return the pose of a frame in its root for one message.

        stamp_ns: stamp of the message, for moving frames; recorded_ns: time of its recording, for
        static ones.
        Raises ValueError if the transforms run in a circle."""
        placed = np.eye(4)
        gap = 0.0
        for _ in range(MAX_LINKS):
            if frame in self.static:
                frame, pose = self.static[frame].last_before(recorded_ns)
            elif frame in self.moving:
                frame, pose, distance = self.moving[frame].interpolate(stamp_ns)
                gap = max(gap, distance)
            else:
                return Placed(frame, placed, gap)
            placed = pose @ placed
        raise ValueError(f"its tf runs in a circle, through {frame!r}")


def between(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose at a share of the way from a to b: on a straight line, turning evenly.

    share: 0 for a, 1 for b."""
    from scipy.spatial.transform import Rotation, Slerp

    pose = np.eye(4)
    pose[:3, :3] = Slerp([0, 1], Rotation.from_matrix(np.stack([a[:3, :3], b[:3, :3]])))(
        share
    ).as_matrix()
    pose[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    return pose


def parse_link_pose(
    wxyz: Float64[np.ndarray, "4"], position: Float64[np.ndarray, "3"]
) -> Pose | None:
    """Return the pose of a transform's quaternion w x y z and position (m), None if malformed."""
    if not (np.isfinite(wxyz).all() and np.isfinite(position).all()):
        return None
    try:
        return quaternion_pose(wxyz, position)
    except ValueError:
        return None
