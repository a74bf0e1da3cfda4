"""Index of a bag: the stamps and transforms of its messages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from toolkit.datasets.layouts.bag_messages import (
    CLOUD,
    OLD_TF,
    TF,
    BagMessage,
    clean_frame,
    name_bag_damage,
    open_bag,
    read_messages,
    stamp_ns,
)
from toolkit.datasets.transform_tree import NS_PER_S, TransformLink, TransformTree, parse_link_pose

OTHER_CLOCKS = (
    "clouds of the time of their recording: stamps of clouds and tf are of different clocks"
)
# largest difference between topics' median delays from stamp to recording, if clocks are the same
MAX_CLOCK_OFFSET_S = 1.0


@dataclass
class BagIndex:
    """Contents of a bag, without the points.

    Attributes:
        stamps_ns: stamps of each topic's clouds, in the order of recording.
        recorded_ns: times of recording of each topic's clouds.
        with_points: by topic, True if its first readable cloud has x, y and z.
        links: transforms of tf, in the order of recording.
        reason: error of the last cloud that cannot be read, None without such a cloud.
    """

    stamps_ns: dict[str, list[int]] = field(default_factory=dict)
    recorded_ns: dict[str, list[int]] = field(default_factory=dict)
    with_points: dict[str, bool] = field(default_factory=dict)
    links: list[TransformLink] = field(default_factory=list)
    reason: Exception | None = None


def index_messages(path: Path) -> BagIndex:
    """Read all stamps and transforms of a bag; the points of its clouds stay unread."""
    index = BagIndex()
    for message in read_messages(path, CLOUD, TF, OLD_TF):
        topic = message.topic
        if message.kind != CLOUD:
            index.links += _parse_links(path, message)
            continue
        # one readable cloud of each topic is parsed, to look at its fields
        if topic not in index.with_points:
            try:
                names = {str(column.name) for column in message.parse().fields}
                index.with_points[topic] = {"x", "y", "z"} <= names
            except Exception as error:  # rosbags and its parsers raise errors of any kind
                index.reason = error
        with name_bag_damage(path):
            index.stamps_ns.setdefault(topic, []).append(message.read_stamp())
        index.recorded_ns.setdefault(topic, []).append(message.recorded_ns)
    return index


def moving_times(
    links: Sequence[TransformLink], tree: TransformTree
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Stamps and times of recording (ns) of moving transforms, under the topic of tf.

    links: all transforms; tree: states which frames move. Empty without such a transform."""
    moving_links = [
        link for link in links if not link.is_static and link.stamp_ns and link.child in tree.moving
    ]
    if not moving_links:
        return {}
    stamps = np.array([link.stamp_ns for link in moving_links])
    recorded_ns = np.array([link.recorded_ns for link in moving_links])
    return {TF: (stamps, recorded_ns)}


def find_other_clocks(
    clouds: Mapping[str, tuple[np.ndarray, np.ndarray]],
    moving: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> dict[str, str]:
    """Topics whose clouds get the time of their recording instead of their stamp, with the reason.

    All topics are returned if stamps are of different clocks, else none. clouds: stamps and times
    of recording (ns) by topic; moving: the same for moving transforms."""
    delays_s = []  # usual delay from stamp to recording, of each topic
    for stamps, recorded_ns in (*clouds.values(), *moving.values()):
        is_stamped = stamps != 0
        delays_ns = recorded_ns[is_stamped] - stamps[is_stamped]
        delays_s.append(float(np.median(delays_ns)) / NS_PER_S if len(delays_ns) else 0.0)
    if max(delays_s) - min(delays_s) <= MAX_CLOCK_OFFSET_S:
        return {}
    return dict.fromkeys(clouds, OTHER_CLOCKS)


def refuse_bag(path: Path, has_clouds: bool, reason: Exception | None) -> None:
    """Raise ValueError that explains why no clouds can be read from a bag.

    has_clouds: True if there are clouds, but none with x, y and z; reason: error of a cloud that
    cannot be read, None without such a cloud."""
    if reason is not None:
        with name_bag_damage(path):  # makes it a ValueError that names the bag
            raise reason
    if has_clouds:
        raise ValueError(
            f"{path} holds {CLOUD} without fields x, y and z only: convert them to points first"
        )
    kinds: dict[str, str] = {}  # message type of each topic
    with open_bag(path) as readers:
        for reader in readers:
            for connection in reader.connections:
                kinds[str(connection.topic)] = str(connection.msgtype)
    first_kinds = sorted(kinds.items())[:6]
    content = ", ".join(f"{topic} ({kind})" for topic, kind in first_kinds) or "no topics"
    raise ValueError(
        f"{path} holds no messages of {CLOUD}, but {content}: convert its lidar's messages to "
        "PointCloud2"
    )


def _parse_links(path: Path, message: BagMessage) -> list[TransformLink]:
    """Parse the transforms of one message of tf, from a child frame to its parent each.

    path: the bag, for errors."""
    is_static = message.topic.rstrip("/").endswith("tf_static")
    with name_bag_damage(path):
        content = message.parse()
        links = []
        for transform_stamped in content.transforms:
            translation = transform_stamped.transform.translation
            rotation = transform_stamped.transform.rotation
            pose = parse_link_pose(
                wxyz=np.array([rotation.w, rotation.x, rotation.y, rotation.z]),
                position=np.array([translation.x, translation.y, translation.z]),
            )
            link = TransformLink(
                child=clean_frame(transform_stamped.child_frame_id),
                parent=clean_frame(transform_stamped.header.frame_id),
                parent_SE3_child=pose,
                stamp_ns=stamp_ns(transform_stamped.header),
                recorded_ns=message.recorded_ns,
                is_static=is_static,
            )
            links.append(link)
    return links
