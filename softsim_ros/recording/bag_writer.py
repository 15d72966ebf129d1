"""Write a rosbag2 folder with one MCAP file, of which a crash loses at most a second; repair it."""

from __future__ import annotations

import fcntl
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, WriterError
from rosbags.typesys import Stores, get_typestore

from softsim_core.base import put_in_place, refuse_links, write_file
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.errors import BagError, RecordingError
from softsim_ros.recording.integrity import ChecksummedWriter, end_torn_file, is_torn

VERSION: Literal[9] = 9
"""Version of the folder's metadata, that of ROS 2 Jazzy."""


class BagWriter:
    """Writes serialised messages of several topics in the order in which they arrive.

    Args:
        folder: The bag; must not exist yet.
        notes: Stored in the bag's metadata as custom data: the robot and its namespace.

    Attributes:
        folder: The bag.
        count: Number of messages written.

    Raises:
        RecordingError: the folder exists or cannot be created.
    """

    def __init__(self, folder: Path, notes: dict[str, str]) -> None:
        self.folder, self.count = folder, 0
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        self._newest = 0
        self._begin = 0
        try:
            self._writer = ChecksummedWriter(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            for key, value in notes.items():
                self._writer.set_custom_data(key, value)
            self._writer.open()
        except WriterError:
            raise RecordingError(f"{folder} exists already and is kept; record to another folder") from None
        except OSError as error:
            reason = f"cannot record to {folder}: {error.strerror}; choose another folder"
            raise RecordingError(reason) from error
        storage: Any = self._writer.storage
        self._file = storage  # the MCAP file, whose chunks `flush` closes
        self._file.bio.flush()
        fcntl.flock(self._file.bio, fcntl.LOCK_EX | fcntl.LOCK_NB)  # shows `repair` that it is being written

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics added so far."""
        return tuple(self._connections)

    @property
    def size(self) -> int:
        """Bytes on the disk and pending bytes, of which the latter are not compressed yet."""
        return int(self._file.bio.tell()) + int(self._file.chunk.bio.tell())

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last one, in [s]."""
        return 1e-9 * (self._newest - self._begin)

    def knows(self, type_name: str) -> bool:
        """Return whether a bag can describe messages of a type such as "sensor_msgs/msg/JointState"."""
        return type_name in self._types.fielddefs

    def add_topic(self, topic: str, type_name: str, offered: Sequence[Qos] = ()) -> None:
        """Add a topic before its first message; a known one stays as it is."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, type_name, typestore=self._types, offered_qos_profiles=list(offered)
            )

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message.

        Args:
            topic: A topic that was added.
            stamp_ns: Time of its arrival, in [ns] since 1970; an earlier stamp than the last one is replaced
                by that.
            data: The serialised message (CDR).

        Raises:
            RecordingError: it cannot be written (disk full); the bag is closed with its present content.
        """
        self._newest = max(self._newest, stamp_ns)
        self._begin = self._begin or self._newest
        try:
            self._writer.write(self._connections[topic], self._newest, data)
        except OSError as error:
            self._give_up(error)
        self.count += 1

    def flush(self) -> None:
        """Pass everything so far to the operating system, so that it survives a crash of this process.

        Raises:
            RecordingError: as `write`.
        """
        try:
            if self._file.chunk.bio.tell():
                self._file.close_chunk()
            self._file.bio.flush()
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """Write index and metadata; the bag is complete.

        Raises:
            RecordingError: as `write`.
        """
        try:
            self._writer.close()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, cause: OSError) -> None:
        """Close the file so that it is readable, and raise with the reason why it ends here."""
        with suppress(OSError):
            self._writer.abort()
        advice = "what was written before could not be closed: see softsim record --repair"
        with suppress(OSError):
            end_torn_file(self._file.path)
            advice = "what was written before can be read"
        raise RecordingError(f"recording to {self.folder} stopped: {cause.strerror}; {advice}") from cause


def repair(path: Path) -> str:
    """Close a bag in place, with all data that reached the disk; return a message.

    Raises:
        BagError: no bag, not an MCAP file, or still being recorded.
        RecordingError: it cannot be written.
    """
    path = path.expanduser()
    try:
        refuse_links(path)
    except OSError as error:
        raise BagError(path, f"cannot be repaired ({error.strerror})") from error
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise BagError(path, "is no folder with one .mcap file; only such bags can be repaired")
    if not is_torn(files[0]) and (path / "metadata.yaml").is_file():
        return f"{path} is whole: nothing to repair"
    with files[0].open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BagError(path, "is being recorded; end that first (Ctrl-C)") from None
    if is_torn(files[0]):
        try:
            end_torn_file(files[0])
        except OSError as error:
            raise BagError(path, f"cannot be written ({error.strerror})") from error
    count = _write_again(path, files[0])
    return f"{path}: repaired, {count} messages"


def _write_again(folder: Path, file: Path) -> int:
    """Copy the messages into a bag with index and metadata, and move its files into place."""
    repaired_folder = folder / "repaired"
    _clear(repaired_folder)
    with Bag(file) as torn:
        writer = BagWriter(repaired_folder, {"robot": torn.robot, "namespace": torn.namespace})
        for topic, type_name in torn.topics.items():
            offered = torn.offered_qos(topic)
            writer.add_topic(topic, type_name, [offered] if offered else [])
        for message in torn.raw_messages():
            writer.write(message.topic, message.stamp_ns, message.data)
        writer.close()
    put_in_place(repaired_folder / "repaired.mcap", file)
    metadata = (repaired_folder / "metadata.yaml").read_text().replace("repaired.mcap", file.name)
    write_file(folder / "metadata.yaml", metadata)
    _clear(repaired_folder)
    return writer.count


def _clear(repaired_folder: Path) -> None:
    """Remove the temporary folder of a repair, also of one that was interrupted.

    Raises:
        BagError: it contains something else.
    """
    for name in ("repaired.mcap", "metadata.yaml"):
        (repaired_folder / name).unlink(missing_ok=True)
    try:
        repaired_folder.rmdir()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise BagError(repaired_folder, f"is not of a repair ({error.strerror}); move it away") from error
