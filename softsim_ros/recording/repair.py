"""Bags whose recorder was killed: closed again, with index and metadata."""

from __future__ import annotations

import fcntl
from pathlib import Path

from softsim_core.file_writing import put_in_place, refuse_links, write_file
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
    """Copy the messages into a bag with index and metadata, and put its files in place."""
    aside = folder / "repaired"
    _clear(aside)
    with Bag(file) as torn:
        writer = BagWriter(aside, {"robot": torn.robot, "namespace": torn.namespace})
        for topic, type_name in torn.topics.items():
            offered = torn.offered_qos(topic)
            writer.add_topic(topic, type_name, [offered] if offered else [])
        for message in torn.raw_messages():
            writer.write(message.topic, message.stamp_ns, message.data)
        writer.close()
    put_in_place(aside / "repaired.mcap", file)
    metadata = (aside / "metadata.yaml").read_text().replace("repaired.mcap", file.name)
    write_file(folder / "metadata.yaml", metadata)
    _clear(aside)
    return writer.count


def _clear(aside: Path) -> None:
    """Remove the folder of a repair, also of one that was ended before its last step.

    Raises:
        BagError: it holds something else.
    """
    for name in ("repaired.mcap", "metadata.yaml"):
        (aside / name).unlink(missing_ok=True)
    try:
        aside.rmdir()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise BagError(aside, f"is not of a repair ({error.strerror}); move it away") from error
