"""Coordinate systems of OpenLABEL's frames.

pose_wrt_parent places a system in its parent: matrix4x4 by rows, quaternion x y z w and
translation, or euler_angles in their `sequence` (ZYX) and translation. A frame's `transforms`
replace it: X_dst = transform_src_to_dst X_src."""

from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets.layouts.openlabel_transforms import find_transform, parse_transform
from toolkit.datasets.record_values import Unchecked, entry
from toolkit.geometry import invert

MAX_SYSTEMS_DEEP = 64  # in a chain of coordinate systems; longer ones run in a circle
NO_POSE = "coordinate systems without a pose in their parent, taken as being at its origin"
UNREADABLE_POSE = "coordinate systems that hold nothing here, whose poses cannot be read"


@dataclass(frozen=True)
class Systems:
    """Coordinate systems of one frame.

    Attributes:
        parents: by system, the name of its parent and parent_SE3_system.
        known: names of all systems.
        unplaced: systems whose pose in their parent nothing states.
        unreadable: systems whose pose cannot be read, with the reason; only boxes and clouds in
            them fail."""

    parents: dict[str, tuple[str, Pose]]
    known: frozenset[str]
    unplaced: frozenset[str] = field(default_factory=frozenset)
    unreadable: dict[str, str] = field(default_factory=dict)

    def find_root(self, name: str) -> tuple[str, Pose]:
        """Return the name of a coordinate system's root, and the system's pose in the root.

        Raises ValueError if a pose on the way cannot be read, or the systems run in a circle."""
        ancestor = name
        ancestor_SE3_system = np.eye(4)
        for _ in range(MAX_SYSTEMS_DEEP):
            if ancestor in self.unreadable:
                raise ValueError(self.unreadable[ancestor])
            if ancestor not in self.parents:
                return ancestor, ancestor_SE3_system
            parent, parent_SE3_ancestor = self.parents[ancestor]
            ancestor_SE3_system = parent_SE3_ancestor @ ancestor_SE3_system
            ancestor = parent
        raise ValueError(f"its coordinate systems run in a circle, through {ancestor!r}")

    def list_roots(self) -> set[str]:
        """Return the names of the roots of all coordinate systems that can be read."""
        roots = set()
        for name in self.known:
            with suppress(ValueError):
                root, _ = self.find_root(name)
                roots.add(root)
        return roots


def parse_systems(content: Unchecked, frame: Unchecked) -> Systems:
    """Parse the coordinate systems of one frame.

    content: content of the file, with poses in parents; frame: content of the frame, whose
    transforms replace these poses."""
    parents: dict[str, tuple[str, Pose]] = {}
    unplaced = set()
    unreadable = dict[str, str]()
    systems = content.get("coordinate_systems") or {}
    for name, system in systems.items():
        parent = str(system.get("parent") or "")
        pose_content = system.get("pose_wrt_parent")
        if pose_content:
            try:
                parents[name] = parent, parse_transform(pose_content, f"pose of {name}")
            except ValueError as error:
                unreadable[name] = str(error)
        elif parent:
            parents[name] = parent, np.eye(4)
            unplaced.add(name)
    system_names = {*systems, *(parent for parent, _ in parents.values())}
    for title, link in ((frame.get("frame_properties") or {}).get("transforms") or {}).items():
        source = str(entry(link, "src"))
        target = str(entry(link, "dst"))
        system_names |= {source, target}
        try:
            dst_SE3_src = parse_transform(find_transform(link), f"transform {title}")
        except ValueError as error:
            unreadable[source] = str(error)
            continue
        # one of the two becomes the other's parent: the source, if it is already, or if it has
        # another parent
        parent_of_source, _ = parents.get(source, (None, None))
        parent_of_target, _ = parents.get(target, ("", None))
        if parent_of_target == source or parent_of_source not in (None, target):
            parents[target] = source, invert(dst_SE3_src)
            unplaced.discard(target)
            unreadable.pop(target, None)
        else:
            parents[source] = target, dst_SE3_src
            unplaced.discard(source)
            unreadable.pop(source, None)
    return Systems(
        parents, known=frozenset(system_names), unplaced=frozenset(unplaced), unreadable=unreadable
    )
