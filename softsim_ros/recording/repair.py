"""Bags whose recorder was killed: closed again, with index and metadata."""

from __future__ import annotations

import fcntl
from pathlib import Path

from softsim_ros.recording.bag import Bag
from softsim_ros.recording.bag_writer import BagWriter
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.torn_files import end_torn_file, is_torn


def repair(path: Path) -> str:
    """Close a bag in place; what reached the disk is kept. Returns a sentence.

    Raises:
        BagError: no bag, not an MCAP file, or still being recorded.
        RecordingError: it cannot be written.
    """
    path = path.expanduser()
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
    """Copy the messages into a bag with index and metadata, and put its files in place."""
    aside = folder / "repaired"
    with Bag(file) as torn:
        writer = BagWriter(aside, {"robot": torn.robot, "namespace": torn.namespace})
        for topic, type_name in torn.topics.items():
            offered = torn.offered_qos(topic)
            writer.add_topic(topic, type_name, [offered] if offered else [])
        for message in torn.raw_messages():
            writer.write(message.topic, message.stamp_ns, message.data)
        writer.close()
    (aside / "repaired.mcap").replace(file)
    metadata = (aside / "metadata.yaml").read_text().replace("repaired.mcap", file.name)
    (folder / "metadata.yaml").write_text(metadata)
    (aside / "metadata.yaml").unlink()
    aside.rmdir()
    return writer.count
