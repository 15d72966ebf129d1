"""Bags as files: written here, read back by an independent reader; torn ones; a full disk."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

from bag_rows import COMMANDS, NOTES, Row, command, rows, write

from softsim_ros.recording import Bag, BagError, BagWriter, RecordingError, is_torn, repair


def read_independently(folder: Path) -> list[Row]:
    """The messages as the reader of the MCAP project sees them."""
    reader = pytest.importorskip("mcap.reader")
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        messages = reader.make_reader(stream, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


def read(path: Path) -> list[Row]:
    with Bag(path) as bag:
        return [tuple(message) for message in bag.raw_messages()]


def test_messages_come_back_as_they_were_written(tmp_path: Path) -> None:
    written = rows(500)
    write(tmp_path / "bag", written).close()
    assert read_independently(tmp_path / "bag") == written
    assert read(tmp_path / "bag") == written
    with Bag(tmp_path / "bag") as bag:
        assert bag.robot, bag.namespace == ("tripod", "/tripod")
        assert bag.counts == {COMMANDS: 500}
        assert bag.duration_s == pytest.approx(4.99)
        assert bag.topic("position_controller/commands") == COMMANDS


def test_the_independent_decoder_reads_the_values(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder")
    reader = pytest.importorskip("mcap.reader")
    write(tmp_path / "bag", [(COMMANDS, 5, command([0.25, -1.0, 2.5]))]).close()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as stream:
        ((_, _, _, message),) = reader.make_reader(
            stream, decoder_factories=[decoder.DecoderFactory()]
        ).iter_decoded_messages()
    assert list(message.data) == [0.25, -1.0, 2.5]


def test_a_clock_that_is_set_back_is_held(tmp_path: Path) -> None:
    write(tmp_path / "bag", [(COMMANDS, stamp, command([1.0])) for stamp in (10, 30, 20, 40)]).close()
    assert [stamp for _, stamp, _ in read_independently(tmp_path / "bag")] == [10, 30, 30, 40]


def test_an_existing_folder_is_kept(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="exists already and is kept"):
        BagWriter(tmp_path, NOTES)


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"cannot record to .*; choose another folder"):
        BagWriter(tmp_path / "file" / "bag", NOTES)


def torn(folder: Path, messages: list[Row]) -> Path:
    """A bag as kill -9 leaves it: nothing after the last flush, then half a record."""
    writer = write(folder, messages)
    writer.flush()
    (file,) = folder.glob("*.mcap")
    data = file.read_bytes()
    writer.close()
    (folder / "metadata.yaml").unlink()
    file.write_bytes(data + data[-300:])
    return file


def test_a_killed_recording_is_repaired_to_its_last_flush(tmp_path: Path) -> None:
    written = rows(300)
    file = torn(tmp_path / "bag", written)
    assert is_torn(file)
    with pytest.raises(BagError, match=r"was not closed.*softsim record --repair"):
        Bag(tmp_path / "bag")
    assert repair(tmp_path / "bag") == f"{tmp_path / 'bag'}: repaired, 300 messages"
    assert read(tmp_path / "bag") == written
    assert read_independently(tmp_path / "bag") == written
    assert sorted(each.name for each in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    assert "nothing to repair" in repair(tmp_path / "bag")


@pytest.mark.parametrize("name", ["metadata.yaml", "bag.mcap", "repaired"])
def test_a_downloaded_recording_with_a_link_is_refused_and_its_target_kept(tmp_path: Path, name: str) -> None:
    torn(tmp_path / "bag", rows(30))
    place, target = tmp_path / "bag" / name, tmp_path / "mine"
    if name == "bag.mcap":
        place.rename(target)
    elif name == "repaired":
        target.mkdir()
    else:
        target.write_text("mine")
    place.symlink_to(target)
    before = target.read_bytes() if target.is_file() else None
    with pytest.raises(BagError, match=f"{name} is a link, and nothing is written through links"):
        repair(tmp_path / "bag")
    assert (target.read_bytes() if target.is_file() else None) == before
    assert before is not None or list(target.iterdir()) == []


def test_a_repair_that_was_ended_is_begun_again(tmp_path: Path) -> None:
    written = rows(300)
    torn(tmp_path / "bag", written)
    left = tmp_path / "bag" / "repaired"
    left.mkdir()
    (left / "repaired.mcap").write_bytes(b"half of it")
    repair(tmp_path / "bag")
    assert read(tmp_path / "bag") == written
    assert not left.exists()
    (tmp_path / "bag" / "metadata.yaml").unlink()  # ended before its last step
    repair(tmp_path / "bag")
    assert read_independently(tmp_path / "bag") == written


def test_a_folder_of_that_name_with_other_files_is_kept(tmp_path: Path) -> None:
    torn(tmp_path / "bag", rows(30))
    (tmp_path / "bag" / "repaired").mkdir()
    (tmp_path / "bag" / "repaired" / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match=r"repaired: is not of a repair .*move it away"):
        repair(tmp_path / "bag")
    assert (tmp_path / "bag" / "repaired" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("length", [45, 60, 500, 4000, 20_000])
def test_a_file_cut_anywhere_can_be_closed(tmp_path: Path, length: int) -> None:
    written = rows(400)
    file = torn(tmp_path / "bag", written)
    file.write_bytes(file.read_bytes()[:length])
    repair(tmp_path / "bag")
    kept = read(tmp_path / "bag")
    assert kept == written[: len(kept)]


def test_a_file_that_ends_in_its_header_holds_nothing(tmp_path: Path) -> None:
    file = torn(tmp_path / "bag", rows(1))
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(BagError, match="nothing to save"):
        repair(tmp_path / "bag")


def test_a_recording_in_progress_is_not_repaired(tmp_path: Path) -> None:
    writer = write(tmp_path / "bag", rows(10))
    with pytest.raises(BagError, match="is being recorded"):
        repair(tmp_path / "bag")
    writer.close()
    assert len(read(tmp_path / "bag")) == 10


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda folder: None, "does not exist"),
        (lambda folder: folder.mkdir(), "is no bag"),
        (lambda folder: (folder.mkdir(), (folder / "x.mcap").write_text("no")), "cannot be read"),
    ],
)
def test_what_is_no_bag_is_one_sentence(tmp_path: Path, make: Any, reason: str) -> None:
    make(tmp_path / "bag")
    with pytest.raises(BagError, match=reason) as caught:
        Bag(tmp_path / "bag")
    assert "\n" not in str(caught.value)


FULL_DISK = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from bag_rows import rows, write
from softsim_ros.recording import RecordingError
try:
    write(Path(sys.argv[1]), rows(3000, 100)).close()
except RecordingError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_full_disk_ends_with_a_sentence_and_a_bag_that_can_be_read(tmp_path: Path) -> None:
    """The size limit of a process fails as a full disk does, in the middle of a record."""
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "bag"), str(Path(__file__).parent), *sys.path],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, 1_500_000)),
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert "stopped: File too large; what was written before can be read" in result.stdout
    assert "Traceback" not in result.stderr
    kept = read(tmp_path / "bag")
    assert kept == rows(3000, 100)[: len(kept)]
    assert len(kept) > 500
