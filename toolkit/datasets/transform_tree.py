"""Coordinate frames over time, as the topics /tf and /tf_static of a ROS bag state them.

- A static transform holds at all times, whatever its stamp. A later one of the same frame replaces
  it from the time on at which it was recorded, as a listener would see it.
- The pose of a moving frame is interpolated between two transforms to one parent; after the last
  and while its parent changes, it is the pose of the last transform before, and before the first
  the first one's. `gap_s` is how far away the transform is.
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
        """Make the history of one frame from its transforms by time (ns), in any order.

        Every transform must have a pose."""
        times = sorted(by_time)
        links = [by_time[time] for time in times]
        poses = [link.parent_SE3_child for link in links if link.parent_SE3_child is not None]
        return FrameHistory(
            times_ns=np.array(times, np.int64),
            parents=tuple(link.parent for link in links),
            poses=np.stack(poses),
        )

    def last_before(self, time_ns: int) -> tuple[str, Pose]:
        """Return parent and pose of the last transform up to a time (ns).

        If all are later, it is the first one."""
        row = max(0, int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1)
        return self.parents[row], self.poses[row]

    def interpolate(self, time_ns: int) -> tuple[str, Pose, float]:
        """Return the frame's parent, its pose in it, and a gap at a time (ns).

        Between two transforms to one parent the pose is interpolated, otherwise it is the pose of
        the last transform before the time, or of the first one. The gap is the distance (s) from
        the time to the nearest transform used; 0 for a frame of a single transform."""
        times = self.times_ns
        after = int(np.searchsorted(times, time_ns))
        before = after - 1
        if after < len(times) and times[after] == time_ns:
            return self.parents[after], self.poses[after], 0.0
        if 0 < after < len(times) and self.parents[before] == self.parents[after]:
            since_before = time_ns - int(times[before])
            until_after = int(times[after]) - time_ns
            share = since_before / (since_before + until_after)
            pose = between(self.poses[before], self.poses[after], share)
            return self.parents[after], pose, min(since_before, until_after) / NS_PER_S
        row = max(0, before)
        is_single = len(times) == 1  # nothing else is known of the frame
        gap = 0.0 if is_single else abs(time_ns - int(times[row])) / NS_PER_S
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
        """Build the tree of all transforms of a bag, in the order of their recording.

        The last one of several transforms with the same child and time counts."""
        # transforms of each child frame by time (ns)
        static: dict[str, dict[int, TransformLink]] = {}
        moving: dict[str, dict[int, TransformLink]] = {}
        malformed_count = 0
        for link in links:
            # a frame needs a name
            has_two_frames = link.child and link.parent and link.child != link.parent
            if link.parent_SE3_child is None or not has_two_frames:
                malformed_count += 1
            elif link.is_static:
                static.setdefault(link.child, {})[link.recorded_ns] = link
            else:
                # a stamp of 0 is none
                moving.setdefault(link.child, {})[link.stamp_ns or link.recorded_ns] = link
        # a child with static and moving transforms keeps only the static ones
        placed_twice = static.keys() & moving.keys()
        for child in placed_twice:
            del moving[child]
        counts = {MALFORMED: malformed_count, TWICE_PLACED: len(placed_twice)}
        return TransformTree(
            static={child: FrameHistory.from_links(by_time) for child, by_time in static.items()},
            moving={child: FrameHistory.from_links(by_time) for child, by_time in moving.items()},
            problems={kind: count for kind, count in counts.items() if count},
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

        The root is the frame without a parent. stamp_ns: stamp of the message, for moving frames;
        recorded_ns: time of its recording, for static ones. Raises ValueError if the transforms run
        in a circle."""
        ancestor = frame
        ancestor_SE3_frame = np.eye(4)
        max_gap_s = 0.0
        for _ in range(MAX_LINKS):
            if ancestor in self.static:
                parent, pose = self.static[ancestor].last_before(recorded_ns)
            elif ancestor in self.moving:
                parent, pose, gap_s = self.moving[ancestor].interpolate(stamp_ns)
                max_gap_s = max(max_gap_s, gap_s)
            else:
                return Placed(root=ancestor, root_SE3_frame=ancestor_SE3_frame, gap_s=max_gap_s)
            ancestor = parent
            ancestor_SE3_frame = pose @ ancestor_SE3_frame
        raise ValueError(f"its tf runs in a circle, through {ancestor!r}")


def between(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose at a share of the way from a to b: on a straight line, turning evenly.

    a, b: poses in one frame; share: 0 for a, 1 for b."""
    from scipy.spatial.transform import Rotation, Slerp

    rotations = Rotation.from_matrix(np.stack([a[:3, :3], b[:3, :3]]))
    interpolate_rotation = Slerp([0, 1], rotations)
    pose = np.eye(4)
    pose[:3, :3] = interpolate_rotation(share).as_matrix()
    pose[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    return pose


def parse_link_pose(
    wxyz: Float64[np.ndarray, "4"], position: Float64[np.ndarray, "3"]
) -> Pose | None:
    """Return the pose of a transform's quaternion w x y z and position (m), None if malformed.

    A quaternion whose length is not 1, and numbers that are not finite, are malformed."""
    if not (np.isfinite(wxyz).all() and np.isfinite(position).all()):
        return None
    try:
        return quaternion_pose(wxyz, position)
    except ValueError:
        return None
