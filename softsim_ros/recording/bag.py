"""Read bags without ROS: topics, messages in time order, decoded."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from softsim_core.base import SoftSimError, shorten
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.integrity import guard_reader, hold_budget, is_torn

DAMAGE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RecursionError,
    TypeError,
    ValueError,
    struct.error,
    SerdeError,
    TypesysError,
)
"""Errors that reading a damaged bag raises, in the reader or in the code that processes its messages."""

MOST_REASON = 150
"""Largest number of characters quoted from the reader's own error."""


class RawMessage(NamedTuple):
    """A message as it was recorded: full topic, time of arrival in [ns] since 1970, serialised data (CDR)."""

    topic: str
    stamp_ns: int
    data: bytes


class Bag(AbstractContextManager["Bag"]):
    """A rosbag2 folder or a single MCAP or SQLite file, open for reading in a `with` block.

    Args:
        path: Folder with metadata.yaml, or one storage file.

    Attributes:
        path: The bag that was opened.
        robot: Name of the robot, from the metadata; else the namespace.
        namespace: Namespace of the robot, such as "/tripod"; "/" if the bag does not name it.

    Raises:
        BagError: it cannot be read; the message says what to do.
    """

    def __init__(self, path: Path) -> None:
        self._types = get_typestore(Stores.ROS2_JAZZY)
        guard_reader()
        self.path = path
        with self._damage_as_bag_error("cannot be read"):
            self.path = path.expanduser()
            hold_budget(storage := storage_of(self.path))
            self._reader = Reader(storage)
            self._reader.open()
        try:
            self._read_notes()
        except BaseException:
            self._reader.close()
            raise

    def _read_notes(self) -> None:
        """Read robot, namespace and message types of the bag."""
        with self._damage_as_bag_error("cannot be read"):
            notes = getattr(self._reader.storage.metadata, "custom", None) or {}
            ending = "/joint_states"
            spaces = (
                each.topic.removesuffix(ending)
                for each in self._reader.connections
                if each.topic.endswith(ending)
            )
            self.namespace = shorten(str(notes.get("namespace") or next(spaces, "") or "/"), 200)
            self.robot = shorten(str(notes.get("robot") or self.namespace.strip("/")), 200)
            for each in self._reader.connections:  # types that the reader does not know
                if each.msgtype not in self._types.fielddefs and each.msgdef.data:
                    self._types.register(get_types_from_msg(each.msgdef.data, each.msgtype))

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Close the file.

        Raises:
            BagError: in place of an error that a damaged or foreign bag has caused.
        """
        self._reader.close()
        if isinstance(error, DAMAGE) and not isinstance(error, SoftSimError):
            raise self._make_damage_error("is damaged, or no bag of a robot", error) from error

    @contextmanager
    def _damage_as_bag_error(self, what: str) -> Iterator[None]:
        """Convert any error that a damaged bag causes inside the context to a BagError."""
        try:
            yield
        except SoftSimError:
            raise
        except (ReaderError, OSError, AssertionError, *DAMAGE) as error:
            raise self._make_damage_error(what, error) from error

    def _make_damage_error(self, what: str, error: BaseException) -> BagError:
        reason = shorten(str(error), MOST_REASON) or "no reason given"
        cause = reason if isinstance(error, ReaderError | OSError) else f"{type(error).__name__}: {reason}"
        return BagError(self.path, f"{what} ({cause})")

    @property
    def topics(self) -> dict[str, str]:
        """Type of each topic that has messages."""
        return {each.topic: each.msgtype for each in self._reader.connections if each.msgcount}

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages on each topic."""
        counts = Counter[str]()
        for each in self._reader.connections:
            counts[each.topic] += each.msgcount
        return counts

    @property
    def begin_ns(self) -> int:
        """Stamp of the first message in [ns] since 1970."""
        return int(self._reader.start_time)

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last in [s]."""
        return max(0.0, 1e-9 * (self._reader.end_time - 1 - self._reader.start_time))

    def topic(self, name: str) -> str:
        """Return the full name of a robot's topic: "joint_states" is "/tripod/joint_states"."""
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"

    def offered_qos(self, topic: str) -> Qos | None:
        """Return the QoS profile that the publisher offered; None if the bag does not contain it."""
        for each in self._connections([topic]):
            if isinstance(each.ext, ConnectionExtRosbag2) and each.ext.offered_qos_profiles:
                return each.ext.offered_qos_profiles[0]
        return None

    def raw_messages(
        self, topics: Collection[str] | None = None, since_ns: int | None = None, before_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Yield messages in the order of their stamps.

        Args:
            topics: Full names to take; None takes all.
            since_ns: First stamp.
            before_ns: First stamp that is left out.

        Raises:
            BagError: the file is damaged.
        """
        connections = self._reader.connections if topics is None else self._connections(topics)
        if not connections:
            return
        stored = self._reader.messages(connections, since_ns, before_ns)
        while True:
            with self._damage_as_bag_error("is damaged"):
                message = next(stored, None)
            if message is None:
                return
            yield RawMessage(message[0].topic, message[1], message[2])

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield stamp in [ns] and decoded message of one topic, given by its full name."""
        type_name = self.topics.get(topic)
        if type_name is None:
            return
        for message in self.raw_messages([topic]):
            with self._damage_as_bag_error(f"is damaged: a message on {topic} cannot be read"):
                decoded = self._types.deserialize_cdr(message.data, type_name)
            yield message.stamp_ns, decoded

    def _connections(self, topics: Collection[str]) -> list[Connection]:
        return [each for each in self._reader.connections if each.topic in topics]


def storage_of(path: Path) -> Path:
    """Return the path to open: the folder if it has metadata, else its only storage file.

    Raises:
        BagError: there is no bag, or its recorder was killed.
    """
    if not path.exists():
        raise BagError(path, "does not exist; record one with: softsim record")
    files = sorted(path.glob("*.mcap")) + sorted(path.glob("*.db3")) if path.is_dir() else [path]
    if not files:
        raise BagError(path, "is no bag: neither a .mcap nor a .db3 file in it")
    if any(file.suffix == ".mcap" and is_torn(file) for file in files):
        raise BagError(
            path, f"was not closed: its recorder still runs, or was killed (softsim record --repair {path})"
        )
    if (path / "metadata.yaml").is_file() or len(files) > 1:
        return path
    return files[0]
