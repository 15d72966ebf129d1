"""Bags from others: damaged, huge when unpacked, naming what they like; each is refused in a sentence."""

from __future__ import annotations

import struct
from binascii import crc32
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_rows import COMMANDS, command, rows, write
from rosbags.rosbag2 import storage_mcap

from softsim_ros.cli import run_command as main
from softsim_ros.recording import MAGIC, Bag, BagError, BagWriter

pytestmark = pytest.mark.slow

CHUNK, DATA_END = 6, 15


def read(path: Path) -> list[tuple[str, int, bytes]]:
    with Bag(path) as bag:
        for topic in bag.topics:
            list(bag.messages(topic))
        return [tuple(message) for message in bag.raw_messages()]


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Begin and end of each chunk's content."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        kind, length = struct.unpack_from("<BQ", data, at)
        if kind == CHUNK:
            found.append((at + 9, at + 9 + length))
        at += 9 + length
    return found


def test_every_chunk_and_the_index_carry_their_checksum(tmp_path: Path) -> None:
    writer = write(tmp_path / "bag", rows(200))
    writer.flush()
    writer.write(COMMANDS, 10**15, command([1.0]))
    writer.close()
    data = (tmp_path / "bag" / "bag.mcap").read_bytes()
    assert len(chunks(data)) == 2
    for begin, end in chunks(data):
        checksum = struct.unpack_from("<I", data, begin + 24)[0]
        packed = data[begin + 28 + 4 + len("zstd") + 8 : end]
        assert checksum == crc32(storage_mcap.zstd.decompress(packed)) != 0
    begin = struct.unpack_from("<Q", data, len(data) - 28)[0]
    assert struct.unpack_from("<I", data, len(data) - 12)[0] == crc32(data[begin:-12]) != 0
    kind, length, checksum = struct.unpack_from("<BQI", data, begin - 13)
    assert (kind, length) == (DATA_END, 4)
    assert checksum == crc32(data[: begin - 13]) != 0


def test_an_independent_reader_agrees_with_all_checksums(tmp_path: Path) -> None:
    stream_reader = pytest.importorskip("mcap.stream_reader")
    write(tmp_path / "bag", rows(50)).close()
    data = bytearray((tmp_path / "bag" / "bag.mcap").read_bytes())
    assert list(stream_reader.StreamReader(BytesIO(data), validate_crcs=True).records)
    data[chunks(data)[-1][1] + 30] ^= 1  # in the index of the messages, behind the chunk
    with pytest.raises(stream_reader.CRCValidationError):
        list(stream_reader.StreamReader(BytesIO(data), validate_crcs=True).records)


def test_a_flipped_bit_anywhere_before_the_index_is_found(tmp_path: Path) -> None:
    writer = write(tmp_path / "bag", rows(100))
    writer.flush()
    writer.write(COMMANDS, 10**15, command([1.0]))
    writer.close()
    file, rng = tmp_path / "bag" / "bag.mcap", np.random.default_rng(3)
    whole = file.read_bytes()
    summary = struct.unpack_from("<Q", whole, len(whole) - 28)[0]
    inside = {place for begin, end in chunks(whole) for place in range(begin + 40, end)}
    between = sorted({*range(len(MAGIC), summary)} - inside)  # heads, indices of messages, metadata
    for place in (between[int(each)] for each in rng.integers(0, len(between), 100)):
        broken = bytearray(whole)
        broken[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(broken)
        with pytest.raises(BagError, match=r"damaged|cannot be read|refused|was not closed") as caught:
            Bag(tmp_path / "bag")
        assert len(str(caught.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize("seed", range(3))
def test_no_flipped_bit_changes_a_number(tmp_path: Path, seed: int) -> None:
    written = rows(300)
    write(tmp_path / "bag", written).close()
    file = tmp_path / "bag" / "bag.mcap"
    whole = file.read_bytes()
    (begin, end), rng = chunks(whole)[0], np.random.default_rng(seed)
    places = [int(rng.integers(begin + 40, end)) for _ in range(60)]
    summary = struct.unpack_from("<Q", whole, len(whole) - 28)[0]
    places += [int(rng.integers(summary, len(whole) - 37)) for _ in range(60)]
    for place in places:
        broken = bytearray(whole)
        broken[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(broken)
        with pytest.raises(BagError, match=r"damaged|cannot be read") as caught:
            read(tmp_path / "bag")
        assert len(str(caught.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    "seed", [*range(4), *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(4, 34))]
)
def test_a_damaged_bag_is_read_whole_or_refused_in_a_sentence(tmp_path: Path, seed: int) -> None:
    write(tmp_path / "bag", rows(100)).close()
    file, rng = tmp_path / "bag" / "bag.mcap", np.random.default_rng(100 + seed)
    whole, metadata = file.read_bytes(), (tmp_path / "bag" / "metadata.yaml").read_bytes()
    for number in range(60):
        target = [file, tmp_path / "bag" / "metadata.yaml"][number % 2]
        file.write_bytes(whole)
        (tmp_path / "bag" / "metadata.yaml").write_bytes(metadata)
        broken = bytearray(target.read_bytes())
        for place in rng.integers(0, len(broken), int(rng.integers(1, 30))):
            broken[int(place)] = int(rng.integers(256))
        target.write_bytes(broken if number % 3 else broken[: int(rng.integers(len(broken)))])
        with suppress(BagError):  # one sentence; anything else fails here
            read(tmp_path / "bag")


def bomb(folder: Path, announced: int) -> Path:
    """A bag whose only chunk unpacks to 256 MiB of zeros and announces so many bytes."""
    write(folder, rows(1)).close()
    (folder / "metadata.yaml").unlink()
    file = folder / f"{folder.name}.mcap"
    packed = storage_mcap.zstd.compress(bytes(2**28))
    content = struct.pack("<QQQI", 0, 1, announced, 0) + struct.pack("<I", 4) + b"zstd"
    content += struct.pack("<Q", len(packed)) + packed
    data = file.read_bytes()
    begin, _ = chunks(data)[0]
    end = struct.pack("<BQ", 0x0F, 4) + bytes(4) + struct.pack("<BQ", 0x02, 20) + bytes(20) + MAGIC
    file.write_bytes(data[: begin - 9] + struct.pack("<BQ", CHUNK, len(content)) + content + end)
    return file


@pytest.mark.parametrize("announced", [2**28, 2**40, 2**64 - 1, 1000, 0])
def test_a_chunk_that_unpacks_to_far_more_costs_no_memory(tmp_path: Path, announced: int) -> None:
    resource = pytest.importorskip("resource")
    file = bomb(tmp_path / "bag", announced)
    assert file.stat().st_size < 100_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BagError, match=r"would unpack to|size mismatch"):
        read(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # in kB


@pytest.mark.parametrize("mode", ["file", "message", "FILE"])
def test_bags_that_are_compressed_as_a_whole_are_refused(tmp_path: Path, mode: str) -> None:
    write(tmp_path / "bag", rows(3)).close()
    metadata = tmp_path / "bag" / "metadata.yaml"
    text = metadata.read_text().replace("compression_format: ''", "compression_format: zstd")
    metadata.write_text(text.replace("compression_mode: ''", f"compression_mode: {mode}"))
    assert mode in metadata.read_text()
    with pytest.raises(BagError, match="it is compressed"):
        read(tmp_path / "bag")


@pytest.mark.parametrize(
    "name", ["program.py", "{folder}/program.py", "program", "nice", "~nobody/x", "a\x1b[31m" * 900]
)
def test_a_bag_names_no_code(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    (tmp_path / "program.py").write_text(
        "from pathlib import Path\nPath(__file__).with_name('ran').touch()\ndef create_scene(scene): pass\n"
    )
    (tmp_path / "nice.yaml").write_text("name: nice\nextends: tripod.yaml\narm: {urdf: parts.xacro}\n")
    mark = f"${{open({str(tmp_path / 'ran')!r}, 'w').name}}"
    (tmp_path / "parts.xacro").write_text(f'<robot name="r"><link name="{mark}"/></robot>')
    monkeypatch.chdir(tmp_path)
    notes = {"robot": name.format(folder=tmp_path), "namespace": "/tripod"}
    writer = BagWriter(tmp_path / "bag", notes)
    writer.add_topic(COMMANDS, "std_msgs/msg/Float64MultiArray")
    for topic, stamp, data in rows(5):
        writer.write(topic, stamp, data)
    writer.close()
    assert main(["report", str(tmp_path / "bag")]) in (0, 1)
    assert not (tmp_path / "ran").exists()
    assert "\x1b" not in "".join(capsys.readouterr())


@pytest.mark.parametrize("command_name", ["export", "report"])
def test_messages_that_are_not_what_they_say_are_one_sentence(
    tmp_path: Path, command_name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    rng = np.random.default_rng(5)
    writer = write(tmp_path / "bag", rows(2))
    kinds = {"mesh/points": "sensor_msgs/msg/PointCloud2", "mesh/topology": "shape_msgs/msg/Mesh"}
    for topic, kind in kinds.items():
        writer.add_topic(f"/tripod/{topic}", kind)
        writer.write(f"/tripod/{topic}", 10**12, b"\0\1\0\0" + rng.bytes(60))
    writer.close()
    assert main([command_name, str(tmp_path / "bag")]) == 1
    said = capsys.readouterr().err
    assert "is damaged" in said
    assert "Traceback" not in said
    assert said.count("\n") == 1
