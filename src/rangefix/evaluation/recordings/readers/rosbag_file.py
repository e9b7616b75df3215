"""The messages of a bag, through the library rosbags; a damaged file is one clear line, whatever it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from ....errors import one_line
from ..log import RecordingError

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MISSING = "bags are read by the package rosbags: pip install 'rangefix[logs]'"
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
            raise RecordingError(f"{self.path}: no bag, or a damaged one: {one_line(error)}") from None


@contextmanager
def _as_bag(path: Path) -> Iterator[Path]:
    """A path that the library takes: a .db3 or .mcap alone gets a metadata.yaml in a folder for the time."""
    if path.suffix not in STORAGES:
        yield path
        return
    if (path.parent / "metadata.yaml").exists():
        yield path.parent
        return
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

    with TemporaryDirectory() as folder:
        (Path(folder) / path.name).symlink_to(path.resolve())
        text = json.dumps({"rosbag2_bagfile_information": information})
        (Path(folder) / "metadata.yaml").write_text(text)
        yield Path(folder)
