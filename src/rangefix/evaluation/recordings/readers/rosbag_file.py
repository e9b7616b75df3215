"""The messages of a bag, through the library rosbags; a damaged file is one clear line, whatever it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from ....errors import one_line
from ....text_files import NotText, read_text
from ..log import RecordingError

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MISSING = "bags are read by the package rosbags: pip install 'rangefix[logs]'"
ROS1, MCAP, SQLITE = b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3"  # how files begin
KINDS = {ROS1: ".bag", MCAP: ".mcap", SQLITE: ".db3"}
UNINDEXED = "index", "read from file"  # words of the library on a bag of ROS 1 whose end is not there
STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}


class Topic(NamedTuple):
    """A topic: its name, the type of its messages, and how many there are."""

    name: str
    type: str
    messages: int


def time_of(header: Any) -> float:
    """The stamp of a header, s."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


@dataclass(frozen=True)
class Messages:
    """The messages of a bag, read again each time they are asked for.

    Attributes:
        path: A .bag, a folder with metadata.yaml, or a .db3 or .mcap by itself.
    """

    path: Path

    @cached_property
    def topics(self) -> tuple[Topic, ...]:
        """All topics.

        Raises:
            RecordingError: If this is no bag, or a damaged one.
        """
        with self._opened() as reader:
            found: dict[tuple[str, str], int] = {}
            for connection in reader.connections:
                key = connection.topic, connection.msgtype
                found[key] = found.get(key, 0) + connection.msgcount
            return tuple(Topic(name, kind, count) for (name, kind), count in sorted(found.items()))

    def of(self, topics: list[Topic]) -> Iterator[tuple[float, Any]]:
        """Times at which messages of some topics were recorded (s), and the messages.

        Raises:
            RecordingError: If the bag is damaged.
        """
        names = {topic.name for topic in topics}
        with self._opened() as reader:
            wanted = [connection for connection in reader.connections if connection.topic in names]
            for connection, time, raw in reader.messages(wanted):
                yield 1e-9 * time, reader.deserialize(raw, connection.msgtype)

    @contextmanager
    def _opened(self) -> Iterator[AnyReader]:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ModuleNotFoundError:
            raise RecordingError(MISSING) from None
        try:
            with (
                _as_bag(self.path) as path,
                AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader,
            ):
                yield reader
        except RecordingError:
            raise
        except Exception as error:  # of any kind: the library, its codecs and sqlite have their own each
            raise RecordingError(f"{self.path}: {_what_is_wrong(self.path, error)}") from None


def _what_is_wrong(path: Path, error: Exception) -> str:
    """What is wrong with a bag, by an error of the library, its codecs or sqlite."""
    said = one_line(error)
    if path.is_dir() and "metadata" in said.lower():
        return f"no bag, or a damaged one: its metadata.yaml is none of ROS 2: {said}"
    if not path.is_dir() and _suffix(path) == ".bag" and any(word in said.lower() for word in UNINDEXED):
        return f"no bag, or a damaged one: `rosbag reindex` may mend one that is cut off ({said})"
    said = re.sub(r"/\S*/bag\.(?=db3|mcap)", f"{path.stem}.", said)  # the link that the library is given
    return f"no bag, or a damaged one: {said}" if str(error) else "no bag, or a damaged one"


@contextmanager
def _as_bag(path: Path) -> Iterator[Path]:
    """A path that the library takes.

    A file is linked into a folder for the time: by a name with the suffix of what it holds, and a .db3 or
    .mcap beside a metadata.yaml. One that belongs to a bag, as the metadata.yaml beside it says, stands for
    all of it.
    """
    if path.is_dir():
        try:
            read_text(path / "metadata.yaml")
        except NotText as error:
            raise RecordingError(f"{path / 'metadata.yaml'}: {error}") from None
        yield path
        return
    if _belongs_to_folder(path):
        yield path.parent
        return
    suffix = _suffix(path)
    if suffix == path.suffix and suffix not in STORAGES:
        yield path
        return
    with TemporaryDirectory() as folder:
        link = (Path(folder) / "bag").with_suffix(suffix)
        link.symlink_to(path.resolve())
        if suffix in STORAGES:
            _write_metadata(link)
        yield Path(folder) if suffix in STORAGES else link


def _suffix(path: Path) -> str:
    """The suffix that a file's content has; its own where that says nothing."""
    with open(path, "rb") as file:
        start = file.read(16)
    return next((suffix for magic, suffix in KINDS.items() if start.startswith(magic)), path.suffix)


def _belongs_to_folder(path: Path) -> bool:
    """Whether the metadata.yaml beside a file names it."""
    beside = path.parent / "metadata.yaml"
    if not beside.exists():
        return False
    import yaml

    try:
        told = yaml.safe_load(read_text(beside))
        names = told["rosbag2_bagfile_information"]["relative_file_paths"]
        return path.name in {Path(name).name for name in names}
    except (yaml.YAMLError, KeyError, TypeError, ValueError):  # it is of something else
        return False


def _write_metadata(path: Path) -> None:
    """The metadata.yaml that makes a bag of a .db3 or .mcap."""
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    storage = (McapReader if path.suffix == ".mcap" else Sqlite3Reader)(path)
    storage.open()
    try:
        told, connections = storage.metadata, list(storage.connections)
    finally:
        storage.close()
    topics = [
        {
            "topic_metadata": {
                "name": each.topic,
                "type": each.msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
            },
            "message_count": each.msgcount,
        }
        for each in connections
    ]
    information = {
        "version": 5,
        "storage_identifier": STORAGES[path.suffix],
        "relative_file_paths": [path.name],
        "duration": {"nanoseconds": max(told.duration - 1, 0)},
        "starting_time": {"nanoseconds_since_epoch": told.start_time},
        "message_count": told.message_count,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
    }
    import json  # which is YAML, too

    text = json.dumps({"rosbag2_bagfile_information": information})
    path.with_name("metadata.yaml").write_text(text)
