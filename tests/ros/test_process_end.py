"""Every executable ends in order, whatever ends it and whenever; a robot's servos are left at rest."""

from __future__ import annotations

import importlib
import math
import os
import random
import re
import signal
import threading
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest
from bridge_session import BRIDGE, BridgeClient, Stream, bridge_words
from node_processes import NodeProcess, ProcessGroup, spin_until
from waiting import DEADLINE_S

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from std_msgs.msg import Float64MultiArray  # noqa: E402

from servo_bridge.emulator import VirtualBoard  # noqa: E402
from softsim_node import parameters_of  # noqa: E402
from softsim_ros.cli.running import NODES  # noqa: E402

COMMANDS = "position_controller/commands"
KERNELS_S = 150.0  # they may have to be compiled
MOMENT_S = 5.0
"""Longest wait in [s] for processor time of a process that has nothing to do."""

REST = (150, 150, 150)
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
TRIPOD = Path(__file__).resolve().parents[2] / "configs" / "robots" / "tripod.yaml"


@pytest.fixture
def start(tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[ProcessGroup]:
    """Starts a module; whatever still runs at the end is ended and checked."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))
    processes = ProcessGroup(tmp_path)
    yield processes
    processes.end()


@pytest.fixture
def client(ros_domain: int, start: ProcessGroup) -> Iterator[BridgeClient]:
    """A node of the test in the namespace of the robot."""
    made = BridgeClient(ros_domain, start)
    yield made
    made.close()


@pytest.fixture
def slow_tripod(tmp_path: Path) -> Path:
    """A Tripod whose servos take 5 s for their way to rest: more than a process may be paused."""
    limits = "{lower: -2.0225, upper: -0.0255, speed: 0.1}"
    joints = "".join(f"  - {{name: servo_{number}, limits: {limits}}}\n" for number in range(3))
    file = tmp_path / "slow.yaml"
    file.write_text(f"extends: {TRIPOD}\njoints:\n{joints}")
    return file


def looks_after_signals(process: NodeProcess) -> bool:
    """Whether a process that runs has begun to catch SIGHUP."""
    try:
        status = Path(f"/proc/{process.process.pid}/status").read_text()
    except OSError:
        return True
    caught = re.search(r"^SigCgt:\s*([0-9a-f]+)", status, re.MULTILINE)
    return caught is None or bool(int(caught[1], 16) & 1 << signal.SIGHUP - 1)


def used_s(process: NodeProcess) -> float:
    """Processor time in [s] that a process has used; infinite where it has ended."""
    if process.process.poll() is not None:
        return math.inf
    fields = Path(f"/proc/{process.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize(
    ("when", "names"),
    [
        ("importing", tuple(NODES)[::2]),
        ("running", tuple(NODES)[1::2]),
        pytest.param("importing", tuple(NODES), marks=pytest.mark.exhaustive),
        pytest.param("running", tuple(NODES), marks=pytest.mark.exhaustive),
    ],
    ids=["importing", "running", "importing-all", "running-all"],
)
def test_two_signals_at_any_moment_end_every_executable_in_order(
    start: ProcessGroup, when: str, names: tuple[str, ...]
) -> None:
    """Moments are of the processor time of each: a busy machine changes none of them."""
    chance = random.Random(f"moments {when}")

    def end(process: NodeProcess, moments: tuple[float, float], numbers: list[signal.Signals]) -> None:
        spin_until(lambda: looks_after_signals(process))
        if when == "running":
            spin_until(lambda: process.output or process.process.poll() is not None, KERNELS_S)
        begun = used_s(process)
        for moment, number in zip(moments, numbers, strict=True):
            spin_until(lambda moment=moment: used_s(process) >= begun + moment, MOMENT_S)
            process.process.send_signal(number)

    running: list[tuple[str, NodeProcess, threading.Thread]] = []
    for name in names:
        process = start("softsim_ros.cli", "run", name)
        first = chance.uniform(0.0, 1.0 if when == "importing" else 0.05)
        moments = (first, first + chance.uniform(0.0, 0.1))
        ender = threading.Thread(target=end, args=(process, moments, chance.choices(ENDS, k=2)))
        ender.start()
        running.append((name, process, ender))
    for name, process, ender in running:
        ender.join()
        code = process.process.wait(DEADLINE_S)
        said = r"needs a terminal|libsimavr|is in use|no file is named"
        refused = re.search(said, process.output)
        early = process.output == "softsim: interrupted\n"  # before it was a node
        assert code == 0 or (code == 1 and refused) or (code == 130 and early), (name, code, process.output)
        assert not re.search("Traceback|Exception|rror:", process.output), (name, process.output)


@pytest.mark.parametrize("name", NODES)
def test_help_of_every_executable_names_it_and_its_parameters(
    ros_domain: int, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module(NODES[name].module)
    assert importlib.import_module(f"{NODES[name].module.partition('.')[0]}.executables").__dict__[name]
    assert module.main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert f"usage: {name} " in shown
    assert "fixed after the start" in shown
    for parameter, _, about in chain.from_iterable(map(parameters_of, module.PROGRAM.settings)):
        assert f"  {parameter}: " in shown
        assert not about.text.endswith((".", "]"))  # the unit stands beside it


def far(client: BridgeClient, board: VirtualBoard) -> Stream:
    """Drive the servos away from rest, and go on commanding it."""
    stream = Stream(client.publisher(Float64MultiArray, COMMANDS), Float64MultiArray(data=[-1.0] * 3))
    assert board.wait_for(lambda b: b.servo_bytes == (121, 121, 121))
    return stream


@pytest.mark.parametrize("how", ["hang-up", "kill -9 of what started it"])
def test_a_bridge_that_loses_its_terminal_or_its_parent_ends_at_rest(
    start: ProcessGroup, client: BridgeClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")  # as sourcing apt's ROS 2 does
    with VirtualBoard(link=tmp_path / "board") as board:
        words = [BRIDGE, *bridge_words(port=board.port, open_wait_s=0.0, autostart="activate")]
        path = filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")])
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))  # the current folder is no place of modules
        (tmp_path / "runner.py").write_text(
            "import subprocess, sys\nsubprocess.run([sys.executable, '-m', *sys.argv[1:]])\n"
        )
        launcher = start("runner", *words) if how != "hang-up" else start(*words)
        stream = far(client, board)
        assert launcher.says("reached by nodes on this computer only")
        if how == "hang-up":
            assert launcher.end(signal.SIGHUP) == 0
        else:
            launcher.process.kill()
        assert board.wait_for(lambda b: not b.is_open)
        stream.stop()
        assert [packet.servo_bytes for packet in board.packets[-3:]] == [REST] * 3
    if how != "hang-up":
        assert launcher.says("the program that started this one has ended")


def test_while_softsim_up_ends_the_e_stop_is_served(
    start: ProcessGroup, client: BridgeClient, slow_tripod: Path, tmp_path: Path
) -> None:
    with VirtualBoard(link=tmp_path / "board") as board:
        words = ("--namespace", "tripod", "--headless", "--no-viewer", "--send", "--board", board.port)
        up = start("softsim_ros.cli", "up", str(slow_tripod), *words)
        assert up.says("simulating", KERNELS_S), up.output
        far(client, board).stop()
        assert client.trigger("servo_bridge/clear_e_stop").success  # both ends know each other from now on
        up.process.send_signal(signal.SIGINT)
        assert board.wait_for(lambda b: b.servo_bytes is not None and 122 <= b.servo_bytes[0] <= 136)
        assert client.trigger("servo_bridge/e_stop").success
        stopped = board.servo_bytes
        assert up.process.wait(DEADLINE_S) == 0
        assert stopped is not None
        assert board.servo_bytes is not None
        assert abs(board.servo_bytes[0] - stopped[0]) <= 1
        assert board.servo_bytes[0] < REST[0]
    assert "Traceback" not in up.output
