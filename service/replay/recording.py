"""Recordings as streams of messages: ROS 1 bags, ROS 2 bags, MCAP."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class RecordingError(Exception):
    """A recording cannot be used; says why."""


@runtime_checkable
class Recording(Protocol):
    """A recording that is open.

    Attributes:
        topics: Type of message of each topic, as ROS 2 writes it: `sensor_msgs/msg/Image`.
        duration_s: From its first message to its last; 0 where it does not say.
    """

    topics: dict[str, str]
    duration_s: float

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, nanoseconds at which it was recorded, and message, in the order of time."""
        ...

    def __enter__(self) -> Recording: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def open_recording(path: Path) -> Recording:
    """A recording, told by its name: `.bag` (ROS 1), `.mcap`, else a ROS 2 bag (a folder, or its `.db3`).

    Raises:
        RecordingError: There is none, or it cannot be read.
    """
    if not path.exists():
        raise RecordingError(f"there is no recording {path}")
    try:
        return McapRecording(path) if path.suffix == ".mcap" else BagRecording(path)
    except (AnyReaderError, McapError, OSError) as error:
        raise RecordingError(f"{path}: {error}") from error


class BagRecording:
    """A ROS 1 or ROS 2 bag, by rosbags."""

    def __init__(self, path: Path) -> None:
        # Bags of ROS 2 before Iron carry no definitions; the messages that are read here have not changed since.
        self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        try:
            self._reader.open()
        except AnyReaderError:
            raise
        except Exception as error:
            # A truncated file shows itself in as many ways as it has records.
            raise RecordingError(f"{path} cannot be read: {error!r}") from error
        self.topics = {topic: info.msgtype for topic, info in self._reader.topics.items() if info.msgtype}
        self.duration_s = 1e-9 * self._reader.duration if self._reader.message_count else 0.0

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """See `Recording.messages`."""
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if not connections:
            return
        for connection, time_ns, data in self._reader.messages(connections):
            try:
                yield connection.topic, time_ns, self._reader.deserialize(data, connection.msgtype)
            except AnyReaderError as error:
                raise RecordingError(f"{connection.topic}: a message cannot be read: {error}") from error

    def __enter__(self) -> BagRecording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()


class McapRecording:
    """An MCAP file with messages of ROS 2 (CDR) or ROS 1."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        try:
            self._reader: McapReader = make_reader(self._file)
            summary = self._reader.get_summary()
        except Exception as error:
            self._file.close()
            raise RecordingError(f"{path} is no whole MCAP file: {error!r}") from error
        if summary is None:
            self._file.close()
            raise RecordingError(f"{path} has no index: repair it with `mcap recover`")
        told = summary.statistics
        self.duration_s = 1e-9 * (told.message_end_time - told.message_start_time) if told else 0.0
        self._store: Typestore = get_typestore(Stores.EMPTY)
        self.topics: dict[str, str] = {}
        self._encodings: dict[str, str] = {}
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding not in ("cdr", "ros1"):
                continue
            name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
            self.topics[channel.topic] = name
            self._encodings[channel.topic] = channel.message_encoding
            self._learn(schema.encoding, schema.data.decode("utf-8"), name)

    def _learn(self, encoding: str, text: str, name: str) -> None:
        try:
            types = get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, name)
            # A type that two schemas define is the same type, which may be registered once.
            self._store.register({name: found for name, found in types.items() if name not in self._store.fielddefs})
        except TypesysError as error:
            raise RecordingError(f"the definition of {name} cannot be read: {error}") from error

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """See `Recording.messages`."""
        for _, channel, message in self._reader.iter_messages([topic for topic in topics if topic in self.topics]):
            read = self._store.deserialize_ros1 if self._encodings[channel.topic] == "ros1" else (
                self._store.deserialize_cdr
            )  # fmt: skip
            try:
                yield channel.topic, message.log_time, read(message.data, self.topics[channel.topic])
            except SerdeError as error:
                raise RecordingError(f"{channel.topic}: a message cannot be read: {error}") from error

    def __enter__(self) -> McapRecording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
