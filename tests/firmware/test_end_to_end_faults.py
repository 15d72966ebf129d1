"""A computer in a bad state: a full disk, a port that may only be read, one that is another's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

from bridge_session import BridgeClient, Stream
from terminal_session import REPOSITORY

from servo_bridge import PortError
from servo_bridge.driver import SerialTransport, byte_to_width, bytes_to_angles
from servo_bridge.emulator import EmulatedBoardPty
from softsim_core import load_scene

pytestmark = [pytest.mark.usefixtures("emulator")]

NOBODY = 65534


@contextmanager
def as_nobody() -> Iterator[None]:
    """Without root's privilege to open everything; a plain user stays who he is."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(before)


@pytest.mark.ros
@pytest.mark.slow
def test_on_a_full_disk_the_bridge_drives_on_and_ends_in_order(tmp_path: Path, ros_domain: int) -> None:
    from std_msgs.msg import Float64MultiArray

    scene = load_scene("tripod")
    assert scene.board is not None
    pose = (90, 120, 165)
    widths = [byte_to_width(each) for each in pose]
    client = BridgeClient(ros_domain)
    with EmulatedBoardPty(link=tmp_path / "board") as board, (tmp_path / "log.txt").open("wb") as log:
        settings = f"-p port:={board.port} -p source:=commands -p autostart:=activate"
        bridge = f"{sys.executable} -m servo_bridge.nodes.bridge_node --ros-args -r __ns:=/tripod {settings}"
        process = subprocess.Popen(
            ["sh", "-c", f"ulimit -f 0; exec {bridge}"],  # no file can grow by a byte, its own log included
            cwd=REPOSITORY,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
            start_new_session=True,
        )
        stream = None
        try:
            publisher = client.publisher(Float64MultiArray, "position_controller/commands")
            angles = list(bytes_to_angles(pose, scene.board.servos))
            stream = Stream(publisher, Float64MultiArray(data=angles))
            assert board.wait_for(lambda each: each.widths_us() == pytest.approx(widths, abs=1.5))
            process.send_signal(signal.SIGINT)
            assert process.wait(DEADLINE_S) == 0
        finally:
            process.kill()
            process.wait()
            if stream is not None:
                stream.stop()
            client.close()
        rest = [byte_to_width(150)] * 3
        assert [each.width_us for each in board.pulses[-3:]] == pytest.approx(rest, abs=1.5)
    assert (tmp_path / "log.txt").stat().st_size == 0


@pytest.mark.ros
@pytest.mark.slow
def test_a_missing_emulator_is_one_sentence(tmp_path: Path, ros_domain: int) -> None:
    ended = subprocess.run(
        [
            sys.executable,
            "-m",
            "softsim_ros.cli",
            "up",
            "tripod",
            "--no-viewer",
            "--board",
            "emulated",
            "--headless",
        ],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
        env={**os.environ, "SOFTSIM_SIMAVR": "/no/such/library", "XDG_RUNTIME_DIR": str(tmp_path)},
    )
    assert ended.returncode == 1
    assert "apt-get install libsimavr2" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("mode", [0o444, 0o000])
def test_a_port_that_may_not_be_written_says_what_to_run(tmp_path: Path, mode: int) -> None:
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        port = str(Path(board.port).resolve())
        os.chmod(port, mode)  # noqa: PTH101
        with as_nobody(), pytest.raises(PortError, match="usermod -aG dialout"):
            SerialTransport(port)
        assert board.open_count == 0  # so nothing was reset either
