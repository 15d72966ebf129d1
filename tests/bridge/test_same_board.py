"""A bridge drives the board that it has met, or none: strangers behind the same link are told no motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from random import Random
from types import SimpleNamespace

import pytest
from board_driving import robot
from node_processes import spin_until

from servo_bridge import PortError
from servo_bridge.driver import (
    BoardLink,
    BoardSession,
    MetBoard,
    ServoDriver,
    board_session,
    find_same_device,
    link,
    usb_identity,
)
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import (
    Banner,
    BoardFlags,
    ExtendedProtocol,
    FrameParser,
    FrameType,
    LegacyBoard,
    Telemetry,
    candidates,
    frames,
)

BOARD = robot().board
QUIET_S = 0.3
TELEMETRY = frames.telemetry(0, Telemetry(0, BoardFlags.LINK, (1500,) * 3, 0, 0))


class Chatty(LegacyBoard):
    """A gadget that talks all the time, though not in our protocol."""

    say_period_s = 0.01

    def __init__(self, random: Random) -> None:
        super().__init__(3)
        self._random = random

    def say(self, now: float) -> bytes:
        noise = self._random.randbytes(20)
        lines = (b"0.5,1.5,\r\n", TELEMETRY[:-1], noise, b"\xff\x64\x64\x64", b"ready\n")
        return self._random.choice(lines)


class Bridge:
    """A session that opens its port again whenever it was lost, as the node does."""

    def __init__(self, port: str, protocol: str = "auto") -> None:
        self.port = port
        self.session = BoardSession(lambda driver: None)
        self.driver = ServoDriver(robot(), protocol=protocol)
        self.said: list[str] = []
        self.session.open(self.driver, port, QUIET_S)
        self.session.start()

    def lost(self) -> bool:
        """Whether the port was lost, or could not be opened, since the last call; it is opened again then."""
        fault = self.session.fault()
        if fault is None and self.session.connected:
            return False
        if fault is not None:
            self.said.append(str(fault))
            self.session.close()
        try:
            self.session.open_again(self.port, QUIET_S)
        except PortError as error:
            self.said.append(str(error))
        else:
            self.session.start()
        return True

    def refused(self) -> bool:
        """Whether a board was found not to be the one that was met."""
        return any("no board of" in each or "another board" in each for each in self.said)

    def drives(self, board: VirtualBoard) -> bool:
        """Whether the board is told poses before long."""
        before = board.accepted
        return bool(spin_until(lambda: board.accepted > before + 5 or (self.lost() and False)))


def strange(kind: str, link_path: Path, random: Random) -> tuple[VirtualBoard, list[bytes]]:
    """A board behind the link, and what it receives."""
    board = VirtualBoard(link=None, protocol="extended" if kind == "ours" else "auto")
    if kind == "chatty":
        board.model = Chatty(Random(random.random()))
    if kind == "ours" and random.random() < 0.5:
        board.model.identity = random.randrange(frames.NO_IDENTITY)
    received: list[bytes] = []
    feed = board.model.feed

    def record(data: bytes, now: float) -> list[tuple[int, ...]]:
        received.append(data)
        return feed(data, now)

    board.model.feed = record
    board.unplug()
    board.link = link_path
    return board, received


@pytest.fixture
def short_grace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "BANNER_GRACE_S", 0.05)


@pytest.fixture
def original(tmp_path: Path) -> Iterator[VirtualBoard]:
    with VirtualBoard(link=tmp_path / "board", protocol="extended") as board:
        yield board


@pytest.mark.slow
@pytest.mark.usefixtures("short_grace")
@pytest.mark.parametrize("latched", [False, True])
def test_twenty_strangers_on_the_link_are_told_no_motion(original: VirtualBoard, latched: bool) -> None:
    random = Random(4)
    bridge = Bridge(original.port)
    assert bridge.drives(original)
    if latched:
        bridge.driver.motion.e_stop.latch()
    assert original.link is not None
    try:
        for kind in random.sample(["silent", "chatty", "ours", "ours"] * 5, 20):
            original.unplug()
            stranger, received = strange(kind, original.link, random)
            bridge.said.clear()
            with stranger:
                stranger.replug()
                assert spin_until(lambda: stranger.is_open or (bridge.lost() and False))  # noqa: B023
                if random.random() < 0.7:
                    assert spin_until(lambda: bridge.lost() and bridge.refused()), kind
            told = {frame.kind for frame in FrameParser().feed(b"".join(received))}
            assert told <= {FrameType.IDENTIFY}, kind
            assert stranger.accepted == 0
            assert not received or kind == "ours", (kind, received)
            original.replug()
            if random.random() < 0.5:
                assert latched or bridge.drives(original), bridge.said
    finally:
        bridge.session.close()


@pytest.mark.slow
@pytest.mark.usefixtures("short_grace")
def test_a_silent_board_without_usb_is_not_opened_again(tmp_path: Path) -> None:
    """Nothing tells it from another one; after cleanup and configure it is driven."""
    with VirtualBoard(link=tmp_path / "board") as board:
        bridge = Bridge(board.port)
        assert bridge.drives(board)
        board.unplug()
        board.replug()
        assert spin_until(
            lambda: bridge.lost() and "is still the one that was configured is unknown" in bridge.said[-1]
        )
        assert board.open_count == 1
        assert Bridge(board.port).drives(board)


@pytest.mark.slow
@pytest.mark.usefixtures("short_grace")
def test_a_port_lost_before_its_board_spoke_is_opened_again_for_one_that_speaks(
    original: VirtualBoard, tmp_path: Path
) -> None:
    original.model.silent = True  # as in its boot loader
    bridge = Bridge(original.port)
    assert original.wait_for(lambda board: board.is_open)
    original.unplug()
    original.link = None
    with VirtualBoard(link=tmp_path / "board") as stranger:
        refused = "no board of the extended protocol answered"
        assert spin_until(lambda: bridge.lost() and refused in bridge.said[-1])
        assert "unknown; check it, then cleanup and configure" in bridge.said[-1]
        assert stranger.open_count > 0
        assert stranger.received == 0
    original.link, original.model.silent = tmp_path / "board", False
    original.replug()
    assert bridge.drives(original), bridge.said
    bridge.session.close()


@pytest.mark.slow
@pytest.mark.usefixtures("short_grace")
def test_a_board_driven_before_it_said_its_number_is_not_opened_again(original: VirtualBoard) -> None:
    original.model.answer = lambda now: b""  # it never says it
    bridge = Bridge(original.port)
    assert bridge.drives(original)
    original.unplug()
    accepted = original.accepted
    original.replug()
    assert spin_until(
        lambda: bridge.lost() and "is still the one that was configured is unknown" in bridge.said[-1]
    )
    assert original.open_count == 1
    assert original.accepted == accepted
    bridge.session.close()


@pytest.mark.slow
@pytest.mark.usefixtures("short_grace")
def test_a_silent_board_is_known_by_its_usb_chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chip = ["USB 2341:0043 serial number 7"]
    monkeypatch.setattr(board_session, "usb_identity", lambda port: chip[0])
    monkeypatch.setattr(board_session, "find_same_device", lambda port, stable, usb: port)
    with VirtualBoard(link=tmp_path / "board") as board:
        bridge = Bridge(board.port)
        assert bridge.drives(board)
        board.unplug()
        board.replug()
        assert bridge.drives(board)
        chip[0] = "USB 2341:0043 serial number 8"
        before = board.received
        board.unplug()
        board.replug()
        assert spin_until(lambda: bridge.lost() and "another device is on" in bridge.said[-1])
        assert board.received == before
        bridge.session.close()


def met(number: int) -> MetBoard:
    return MetBoard("extended", f"number {number:012x}")


def opened(before: MetBoard | None) -> BoardLink:
    return BoardLink("/dev/board", [each(BOARD) for each in candidates("auto", BOARD)], 2.5, 10.0, before)


def test_a_board_met_before_is_written_to_once_it_has_said_its_number() -> None:
    link = opened(met(7))
    assert not link.asks
    link.receive(TELEMETRY, 11.0)
    assert link.state(11.0) == "waiting"
    assert link.asks
    assert link.board.ask() == frames.identify(1)
    link.receive(frames.identity(1, 7), 11.1)
    assert link.state(11.1) == "extended"
    link.check(11.1)


@pytest.mark.parametrize("number", [8, None])
def test_another_number_or_none_is_another_board(number: int | None) -> None:
    link = opened(met(7))
    link.receive(TELEMETRY, 11.0)
    while question := link.board.ask():
        assert FrameParser().feed(question)[0].kind is FrameType.IDENTIFY
        if number is not None:
            link.receive(frames.identity(1, number), 11.1)
    assert link.state(11.1) == "waiting"
    with pytest.raises(PortError, match=r"another board is on /dev/board .*for this one cleanup"):
        link.check(11.1)


def test_silence_is_no_board_where_one_has_spoken() -> None:
    link = opened(met(7))
    link.receive(b"", 13.0)
    assert link.state(1000.0) == "waiting"
    with pytest.raises(PortError, match="no board of the extended protocol answered"):
        link.check(1000.0)


def test_a_board_that_speaks_is_no_board_where_one_was_silent() -> None:
    link = opened(MetBoard("legacy", ""))
    assert link.state(13.0) == "legacy"
    link = opened(MetBoard("legacy", ""))
    link.receive(TELEMETRY, 11.0)
    assert link.state(13.0) == "waiting"
    with pytest.raises(PortError, match="another board"):
        link.check(11.0)


def test_a_board_without_a_number_is_given_one() -> None:
    assert BOARD is not None
    protocol, board = ExtendedProtocol(BOARD), ExtendedProtocol.board_model(BOARD.servos)
    assert board is not None
    assert protocol.identity() is None
    while question := protocol.ask():
        board.feed(question, 1.0)
        protocol.decode(board.answer(1.0))
    assert protocol.identity() == f"number {board.identity:012x}"
    given = board.identity
    board.reset(1)
    board.feed(frames.identify(1, 5), 2.0)
    assert board.identity == given  # once, for good


def test_old_firmware_is_not_asked_and_has_no_number() -> None:
    assert BOARD is not None
    protocol = ExtendedProtocol(BOARD)
    protocol.decode(frames.banner(0, Banner(frames.PROTOCOL_VERSION, 2, 1, 2)) + TELEMETRY)
    assert protocol.ask() == b""
    assert protocol.identity() == ""
    protocol.begin_takeover()
    assert [each.kind for each in FrameParser().feed(protocol.limits())] == [FrameType.SET_LIMITS]


def chip(device: str, ids: tuple[int, int], serial: str | None, location: str) -> SimpleNamespace:
    vendor, product = ids
    return SimpleNamespace(
        device=device, vid=vendor, pid=product, serial_number=serial, location=location,
        manufacturer=None, description="",
    )  # fmt: skip


UNO, CH340 = (0x2341, 0x0043), (0x1A86, 0x7523)


def test_a_usb_chip_is_found_by_its_serial_number_else_by_its_socket() -> None:
    uno, clone = chip("/dev/a", UNO, "7", "1-1:1.0"), chip("/dev/b", CH340, None, "1-2")
    identity = usb_identity("/dev/a", [uno, clone])
    assert identity == "USB 2341:0043 serial number 7 interface 1.0"
    assert usb_identity("/dev/c", [uno, clone]) == ""
    assert find_same_device("/dev/a", "", identity, ports=[chip("/dev/c", UNO, "7", "2-4:1.0")]) == "/dev/c"
    with pytest.raises(PortError, match=r"serial number 7 .* is not plugged in"):
        find_same_device("/dev/a", "", identity, ports=[chip("/dev/a", UNO, "8", "1-1:1.0")])
    socket = usb_identity("/dev/b", [uno, clone])
    assert socket == "USB 1a86:7523 in USB socket 1-2"
    with pytest.raises(PortError, match="not plugged in"):
        find_same_device("/dev/b", "", socket, ports=[chip("/dev/b", CH340, None, "1-3")])
    with pytest.raises(PortError, match="are the same to USB"):
        find_same_device("/dev/a", "", identity, ports=[uno, chip("/dev/c", UNO, "7", "1-3:1.0")])
