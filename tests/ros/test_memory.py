"""Memory of `softsim up` over what a person does in hours: scenes, pages, commands. Nothing grows."""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from node_processes import Client, NodeProcess, ProcessGroup, descendants, resident_mb
from shared_robots import Robot
from tcp_ports import free_port
from waiting import BUILD_S, DEADLINE_S

pytest.importorskip("rclpy")
pytest.importorskip("viser")
import msgspec
import viser
from std_msgs.msg import Float64MultiArray
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SCENES = ("tripod_ball", "tripod")
PAGES, COMMANDS = 5, 6000
"""Of each round: 60 rounds have 300 pages, and the commands of an hour at 100 Hz."""
SETTLES = 20
"""Rounds in which caches may fill: two minutes."""
GROWTH_MB = 5.0
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0, 0, 0],
    "position": [0.0, 1, 2],
    "look_at": [0.0, 0, 0],
    "up_direction": [0.0, 0, 1],
    "fov": 0.8,
    "near": 0.1,
    "far": 1000,
    "image_height": 600,
    "image_width": 800,
}


async def visit(port: int, messages: int) -> None:
    """Open a page as a browser does, take so many messages and leave."""
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None) as page:
        await page.send(msgspec.msgpack.encode(CAMERA))  # viser knows a page by its camera
        for _ in range(messages):
            await asyncio.wait_for(page.recv(), DEADLINE_S)


class Session:
    """A running `softsim up` with its page, and how much memory each of its processes has."""

    def __init__(self, process: NodeProcess, client: Client, port: int) -> None:
        self.robot, self.port = Robot(process, client), port
        self.commands = client.publisher(Float64MultiArray, "position_controller/commands", 10)
        self.draw = random.Random(1)

    def round(self, number: int) -> None:
        """Swap the scene, open pages, send commands."""
        assert self.robot.set_parameters(robot=SCENES[number % 2]) == (True, "")
        for _ in range(PAGES):
            asyncio.run(visit(self.port, 20))
        for _ in range(COMMANDS):
            self.commands.publish(Float64MultiArray(data=[self.draw.uniform(-1.2, 0.0) for _ in range(3)]))
        answer = self.robot.get_parameters(["robot"])
        assert answer == {"robot": SCENES[number % 2]}

    def memory(self) -> dict[str, float]:
        """Resident memory in [MB] of each process, by what it runs."""
        found = {}
        for pid in (self.robot.process.process.pid, *descendants(self.robot.process.process.pid)):
            with suppress(OSError):  # it has ended
                words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
                name = b" ".join(words[1:5]).decode()
                found[f"{pid} {name}"] = resident_mb(pid)
        return found


@pytest.fixture
def session(start_process: ProcessGroup, client: Client, tmp_path: Path, monkeypatch: Any) -> Session:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    port = free_port()
    words = ("--headless", "--send", "--no-token", "--port", str(port))
    process = start_process("softsim_ros.cli", "up", "tripod", *words)
    assert process.says("open http", BUILD_S), process.output
    assert process.says("simulating", BUILD_S), process.output
    return Session(process, client, port)


@pytest.mark.exhaustive
@pytest.mark.parametrize("rounds", [60])
def test_scenes_pages_and_commands_of_an_hour_leave_no_memory_behind(session: Session, rounds: int) -> None:
    seen = []
    for number in range(rounds):
        session.round(number)
        seen.append(session.memory())
        print(number, {name: round(value, 1) for name, value in seen[-1].items()}, flush=True)
    growth = {
        name: max(row[name] for row in seen[-6:]) - max(row[name] for row in seen[SETTLES - 6 : SETTLES])
        for name in set(seen[-1]) & set(seen[SETTLES - 1])
    }
    assert growth
    assert [name for name, value in growth.items() if value > GROWTH_MB] == [], growth
