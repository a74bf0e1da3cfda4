"""Messages of a bag, by the time of their recording."""

import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from heapq import merge
from os.path import lexists
from pathlib import Path
from typing import Any, NamedTuple

from toolkit.datasets.folders import BAG_ENDINGS, list_bags
from toolkit.datasets.record_values import name_damage
from toolkit.datasets.transform_tree import NS_PER_S
from toolkit.runtime.reading import plain_file, read_text, resolve_below
from toolkit.runtime.text_values import parse_yaml

CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
OLD_TF = "tf/msg/tfMessage"
RosObject = Any  # object of rosbags, which has no types
OTHER_PROFILE = "Profile is not ros2."  # rosbags' words for an .mcap of ROS 1
FIRST_ENDING = ".bag"  # of ROS 1
# rosbags and its parsers raise errors of any kind
name_bag_damage = partial(name_damage, what="bag", kinds=(Exception,))


class BagMessage(NamedTuple):
    """A message of a bag, not parsed.

    Attributes:
        topic: its topic.
        kind: its message type.
        recorded_ns: time of its recording (ns).
        data: its bytes.
        has_seq: True for ROS 1, whose headers begin with a number.
        parser: parses the bytes.
    """

    topic: str
    kind: str
    recorded_ns: int
    data: bytes
    has_seq: bool
    parser: Callable[[bytes], RosObject]

    def parse(self) -> RosObject:
        """Return the message's object. Raises errors of any kind for a damaged one."""
        return self.parser(self.data)

    def read_stamp(self) -> int:
        """Stamp (ns) of the header that the message begins with, without parsing the message."""
        # the stamp comes after 4 bytes: the number of ROS 1, or the start of CDR, whose second byte
        # gives the byte order
        if self.has_seq:
            seconds, nanoseconds = struct.unpack_from("<II", self.data, offset=4)
        else:
            order = "<" if self.data[1] & 1 else ">"
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", self.data, offset=4)
        return int(seconds) * NS_PER_S + int(nanoseconds)


def clean_frame(name: object) -> str:
    """Name of a coordinate frame without the slash that tf of ROS 1 puts before it."""
    return str(name).strip("/")


def stamp_ns(header: RosObject) -> int:
    """Stamp (ns) of a header."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


@contextmanager
def open_bag(path: Path) -> Iterator[list[RosObject]]:
    """Open a bag and yield the readers of its files, which close at the end."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise ImportError("reading bags needs rosbags: pip install rosbags") from None
    with ExitStack() as stack:
        readers = []
        with name_bag_damage(path):
            for file in _list_files(path):
                reader_class = rosbag1.Reader if _is_first_ros(file) else rosbag2.Reader
                try:
                    readers.append(stack.enter_context(reader_class(file)))
                except rosbag2.ReaderError as error:
                    if str(error) != OTHER_PROFILE:
                        raise
                    remedy = "give the .bag it was made of, or convert that with rosbags-convert"
                    raise ValueError(
                        f"its messages are not of ROS 2 (its profile tells): {remedy}"
                    ) from None
        yield readers


def enter_bag_folder(path: Path) -> Path:
    """Return the subfolder that holds the bag, or the path itself if there is no such subfolder.

    Writing makes a folder with the bag one level below. If the path is a folder without files of a
    bag, and exactly one of its subfolders is a bag, this subfolder comes back."""
    if not path.is_dir() or lexists(path / "metadata.yaml") or list_bags(path):
        return path
    folders = [folder for folder in sorted(path.iterdir()) if lexists(folder / "metadata.yaml")]
    return folders[0] if len(folders) == 1 else path


def _is_first_ros(path: Path) -> bool:
    """Return True if a bag is of ROS 1: a file, since a folder named *.bag is of ROS 2."""
    return path.suffix.lower() == FIRST_ENDING and not path.is_dir()


def _list_files(path: Path) -> list[Path]:
    """List the paths to open for a bag: its files, or only its folder if that has metadata.

    Raises ValueError for a folder without bags or with bags of several kinds, and for files that
    are no plain files or are outside the folder."""
    metadata = path / "metadata.yaml"
    if lexists(metadata):
        content = parse_yaml(read_text(plain_file(metadata)))
        for name in content["rosbag2_bagfile_information"]["relative_file_paths"]:
            plain_file(resolve_below(path, str(name)))  # only checked: rosbags opens them
        return [path]
    if not path.is_dir():
        return [plain_file(path)]
    files = list_bags(path)
    if not files:
        raise ValueError(f"it holds no file of {', '.join(BAG_ENDINGS)}")
    if len({file.suffix.lower() for file in files}) > 1:
        raise ValueError(
            f"it holds bags of several kinds, {', '.join(file.name for file in files[:6])}: give "
            "one file"
        )
    return [plain_file(file) for file in files]


def _make_parser(
    kind: str, readers: Iterable[RosObject], has_seq: bool
) -> Callable[[bytes], RosObject]:
    """Make the parser of one message type, by its definition in the bag, else by ROS 2 Humble's.

    kind: the message type; readers: rosbags' readers of the bag's files; has_seq: True for ROS
    1."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    definitions = []
    for reader in readers:
        for connection in reader.connections:
            has_definition = connection.msgdef.format != MessageDefinitionFormat.NONE
            if connection.msgtype == kind and has_definition:
                definitions.append(connection.msgdef)
    store = get_typestore(Stores.EMPTY if definitions else Stores.ROS2_HUMBLE)
    if definitions and definitions[0].format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definitions[0].data, kind))
    elif definitions:
        # IDL files, one after the other, each below a line of = and one with its name
        for text in definitions[0].data.split(f"{'=' * 80}\n"):
            idl = text.split("\n", 1)[1] if text.startswith("IDL: ") else text
            store.register(get_types_from_idl(idl))
    parse = store.deserialize_ros1 if has_seq else store.deserialize_cdr
    return partial(_call, parse, kind)


def _call(parse: Callable[[bytes, str], RosObject], kind: str, data: bytes) -> RosObject:
    # Parse with the arguments in the order that `partial` needs.
    return parse(data, kind)


def read_messages(path: Path, *kinds: str) -> Iterator[BagMessage]:
    """Yield the messages of some types from all files of a bag, by the time of their recording."""
    with open_bag(path) as readers:
        has_seq = any(map(_is_first_ros, _list_files(path)))
        with name_bag_damage(path):
            streams = []
            parsers: dict[str, Callable[[bytes], RosObject]] = {}  # by message type
            for reader in readers:
                connections = [
                    connection for connection in reader.connections if connection.msgtype in kinds
                ]
                if connections:
                    streams.append(reader.messages(connections=connections))
                for connection in connections:
                    kind = connection.msgtype
                    if kind not in parsers:
                        parsers[kind] = _make_parser(kind, readers, has_seq)
            # rosbags yields triples: connection, time of recording (ns), bytes
            messages = merge(*streams, key=lambda message: message[1])
        while True:
            with name_bag_damage(path):
                next_message = next(messages, None)
                if next_message is None:
                    return
                connection, recorded_ns, data = next_message
            yield BagMessage(
                topic=str(connection.topic),
                kind=connection.msgtype,
                recorded_ns=recorded_ns,
                data=data,
                has_seq=has_seq,
                parser=parsers[connection.msgtype],
            )
