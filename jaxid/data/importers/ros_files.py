"""ROS 2 bags and MCAP files as topics of messages, read by their own libraries.

Definitions of messages come with the recording (MCAP, bags of ROS 2 Iron and later), else from what
ROS 2 itself has.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxid.base.errors import DatasetError, UsageError
from jaxid.base.extras import needed
from jaxid.data.importers.runs import first_line, refused


STATES = ("JointState", "LowState", "JointTrajectoryControllerState", "DynamicJointState")
COMMANDS = (
    "JointState",
    "JointTrajectory",
    "JointTrajectoryControllerState",
    "Float64MultiArray",
    "LowCmd",
)


@dataclass(frozen=True)
class Message:
    """One message: seconds by its own stamp, or by when it was logged where it has none, and its
    fields by name.
    """

    t: float
    get: Callable[[str], Any]


@dataclass
class RosRecording:
    """A file's topics (name -> type without its package, count of messages), and how to read one of
    them.
    """

    path: Path
    topics: dict[str, tuple[str, int]]
    read: Callable[[str], Iterator[Message]]
    trailing: Counter[str] = field(default_factory=Counter)
    start: int | None = None  # ns: the first stamp, from which seconds count

    def seconds(self, stamp: int) -> float:
        """Seconds since the first stamp that was asked for; float64 keeps a clock that counts from
        1970 to 0.2 us only.
        """
        if self.start is None:
            self.start = stamp
        return (stamp - self.start) * 1e-9


def open_bag(path: Path) -> RosRecording:
    """A ROS 2 bag's folder. Raises `DatasetError` for what is none."""
    _exists(path)
    reader_of = needed("rosbags.highlevel").AnyReader
    stores = needed("rosbags.typesys")
    try:
        with reader_of(
            [path], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)
        ) as reader:
            kinds = {c.topic: c.msgtype for c in reader.connections}
            counts = Counter[str]()
            for c in reader.connections:
                counts[c.topic] += c.msgcount
    except Exception as error:  # whatever a damaged bag makes its parser raise
        raise refused(
            path, f"not readable as a ROS 2 bag ({first_line(error)})", "Name the bag's folder"
        ) from None
    recording = RosRecording(
        path,
        {t: (k.rpartition("/")[2], counts[t]) for t, k in kinds.items()},
        lambda topic: iter(()),
    )

    def read(topic: str) -> Iterator[Message]:
        try:
            with reader_of(
                [path], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)
            ) as reader:
                own = [c for c in reader.connections if c.topic == topic]
                for connection, stamp, raw in reader.messages(connections=own):
                    yield _message(
                        _deserialized(reader.typestore, raw, connection.msgtype, recording),
                        stamp,
                        recording,
                    )
        except DatasetError:
            raise
        except Exception as error:
            raise refused(
                path, f"not readable as a ROS 2 bag ({first_line(error)})", _UNKNOWN
            ) from None

    recording.read = read
    return recording


_UNKNOWN = "Record as MCAP (ros2 bag record -s mcap), which keeps the definitions of messages"


def open_mcap(path: Path) -> RosRecording:
    """An MCAP file. Raises `DatasetError` for what is none."""
    _exists(path)
    make_reader = needed("mcap.reader").make_reader
    topics: dict[str, tuple[str, int]] = {}
    try:
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                if channel.topic not in topics:
                    topics[channel.topic] = (_mcap_kind(schema, channel, message), 0)
                kind, count = topics[channel.topic]
                topics[channel.topic] = (kind, count + 1)
    except Exception as error:
        raise refused(
            path, f"not readable as MCAP ({first_line(error)})", "Give an .mcap file"
        ) from None
    recording = RosRecording(path, topics, lambda topic: iter(()))

    def read(topic: str) -> Iterator[Message]:
        try:
            with path.open("rb") as stream:
                store: Any = None
                for schema, channel, message in make_reader(stream).iter_messages(topics=[topic]):
                    if channel.message_encoding == "json":
                        content = json.loads(message.data)
                        yield Message(
                            recording.seconds(_json_stamp(content) or message.log_time), content.get
                        )
                        continue
                    if channel.message_encoding != "cdr" or schema is None:
                        what = (
                            f"topic {topic!r} is encoded as {channel.message_encoding!r}; jaxid"
                            " reads cdr (ROS 2) and json"
                        )
                        raise refused(
                            path, what, "Convert it (rosbags-convert), or record with ROS 2"
                        )
                    store = store or _typestore(schema)
                    yield _message(
                        _deserialized(store, message.data, schema.name, recording),
                        message.log_time,
                        recording,
                    )
        except (DatasetError, UsageError):
            raise
        except Exception as error:
            raise refused(
                path, f"not readable as MCAP ({first_line(error)})", "Give an .mcap file"
            ) from None

    recording.read = read
    return recording


def _exists(path: Path) -> None:
    if not path.exists():
        raise refused(path, f"there is nothing named {path}", "Correct its name")


def _mcap_kind(schema: Any, channel: Any, message: Any) -> str:
    name = "" if schema is None else schema.name.rpartition("/")[2].rpartition(".")[2]
    if channel.message_encoding == "json" and name not in (*STATES, *COMMANDS):
        content = json.loads(message.data)
        if isinstance(content, dict) and {"name", "position"} <= content.keys():
            return "JointState"
    return name or channel.message_encoding


def _typestore(schema: Any) -> Any:
    stores = needed("rosbags.typesys")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    if schema.encoding == "ros2msg" and schema.name not in store.types:
        own = stores.get_types_from_msg(schema.data.decode(), schema.name)
        store.register({k: v for k, v in own.items() if k not in store.types})
    return store


def _deserialized(store: Any, raw: bytes, kind: str, recording: RosRecording) -> Any:
    """The message; some publishers put more bytes behind it, which are counted."""
    try:
        return store.deserialize_cdr(raw, kind)
    except Exception as error:
        if "size mismatch" not in str(error):
            raise
        definition = store.get_msgdef(kind)
        read = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
        message, _ = read(raw[4:], 0, definition.cls, store)
        recording.trailing[kind] += 1
        return message


def _message(body: Any, log_time: int, recording: RosRecording) -> Message:
    header = getattr(body, "header", None)
    own = 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
    return Message(recording.seconds(own or log_time), lambda key: getattr(body, key, None))


def _json_stamp(content: dict[str, Any]) -> int:
    """Nanoseconds of a message's own stamp, 0 where it has none."""
    header = content.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    return (
        int(stamp.get("sec", 0)) * 10**9 + int(stamp.get("nanosec", stamp.get("nsec", 0)))
        if isinstance(stamp, dict)
        else 0
    )
