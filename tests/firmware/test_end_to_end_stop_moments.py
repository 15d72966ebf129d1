"""The stop at random moments of every state of the bridge, measured in the cycles of the emulated board."""

from __future__ import annotations

import random
import signal
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import BRIDGE, BridgeClient, bridge_words
from node_processes import NodeProcess, spin_until
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

from servo_bridge import bridge_node
from servo_bridge.e_stop import EStop
from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.servo import bytes_to_angles
from softsim_core import load_scene
from softsim_ros.runtime import SpinThread

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator")]

LONGEST_WAY_IN_S = {
    "driving": 0.3,
    "activating": 0.3,
    "deactivating": 0.4,
    "configuring": 1.5,
    "reconnecting": 1.5,
}
"""How far into each state in [s] the call comes at most."""

WITHIN_S = 0.025
"""Longest time in [s] from the call to the last pulse of another width: a packet, and a frame of pulses."""

TOLERANCE_US = 1.5
WHOLE_MOVE_S = 0.6
"""Long enough in [s] for a way from limit to limit."""

HEARD_S = 0.2
"""The last command has reached the bridge after this time in [s]: after the clearing none is left."""

MOVING_S = 0.045
"""A width that changed so shortly before the call in [s] was still changing: two frames of pulses."""


class Stopped:
    """A bridge in this process on an emulated board, driven by random commands.

    Attributes:
        calls: When an e-stop arrived at the bridge, in [s] of the board.
    """

    def __init__(self, client: BridgeClient, board: EmulatedBoardPty, seed: int) -> None:
        scene = load_scene("tripod")
        assert scene.board is not None
        self.calls: list[float] = []
        self.client, self.board, self.random = client, board, random.Random(seed)
        self._servos, self._low = scene.board.servos, True
        self._commands = client.publisher(Float64MultiArray, "position_controller/commands")

    def command(self, seconds: float) -> None:
        """Stream a pose near the other end of the range for so long, in the board's time."""
        self._low = not self._low
        pose = [
            self.random.randrange(60, 70) if self._low else self.random.randrange(170, 181) for _ in range(3)
        ]
        message = Float64MultiArray(data=list(bytes_to_angles(pose, self._servos)))
        end = self.board.time_s + seconds
        while self.board.time_s < end:
            self._commands.publish(message)
            self.let_pass(min(0.02, end - self.board.time_s))

    def let_pass(self, seconds: float) -> None:
        end = self.board.time_s + seconds
        assert self.board.wait_for(lambda board: board.time_s > end, 60.0)

    def activate(self) -> None:
        """Sending, with an open port, whatever it was doing before."""

        def active() -> bool:
            state = self.client.state()
            if state in ("unconfigured", "inactive"):  # refused where the bridge goes on by itself meanwhile
                self.client.refuses("configure" if state == "unconfigured" else "activate")
            return state == "active"

        assert spin_until(active, 60.0), self.client.state()

    def get_to(self, state: str) -> None:
        """To a random moment of that state, on the way from one end of the range to the other."""
        if state == "activating":
            self.client.transition("deactivate")
            self.client.ask("activate")
        elif state == "deactivating":
            self.client.ask("deactivate")
        elif state == "configuring":
            self.client.transition("deactivate")
            self.client.transition("cleanup")
            self.client.ask("configure")
        elif state == "reconnecting":
            self.board.unplug()
            self.board.replug()
        self.command(self.random.uniform(0.0, LONGEST_WAY_IN_S[state]))

    def last_change(self) -> float:
        """When the newest pulse began that had another width than the one before, in [s] of the board."""
        newest = 0.0
        for pin in range(3):
            pulses = [pulse for pulse in self.board.pulses if pulse.channel == pin]
            for before, after in pairwise(pulses):
                if abs(after.width_us - before.width_us) > TOLERANCE_US:
                    newest = max(newest, after.start_s)
        return newest


@pytest.fixture
def stopped(
    tmp_path: Path, client: BridgeClient, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[int], Stopped]]:
    """Starts a bridge that sends to a board of its own."""
    made: list[Any] = []

    def starter(seed: int) -> Stopped:
        board = EmulatedBoardPty(link=tmp_path / "board").__enter__()
        overrides = {"port": str(board.link), "autostart": "activate", "source": "commands"}
        bridge = bridge_node.ServoBridge(
            context=client.context,
            namespace="tripod",
            parameter_overrides=[Parameter(key, value=value) for key, value in overrides.items()],
        )
        spinner = SpinThread([bridge], client.context)
        spinner.__enter__()
        made.extend([board, bridge, spinner])
        result = Stopped(client, board, seed)
        latch = EStop.latch

        def noted(e_stop: EStop) -> None:
            result.calls.append(board.time_s)
            latch(e_stop)

        monkeypatch.setattr(EStop, "latch", noted)
        return result

    yield starter
    board, bridge, spinner = made
    bridge.close()
    spinner.close()
    bridge.destroy_node()
    board.close()


@pytest.mark.parametrize("each", [2, pytest.param(40, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("state", LONGEST_WAY_IN_S)
def test_no_pulse_changes_after_the_stop_nor_after_its_clearing(
    stopped: Callable[[int], Stopped], state: str, each: int
) -> None:
    robot = stopped(list(LONGEST_WAY_IN_S).index(state))
    moving = 0
    for number in range(each):
        robot.activate()
        robot.command(WHOLE_MOVE_S)
        robot.get_to(state)
        assert robot.client.trigger("servo_bridge/e_stop").success
        assert robot.client.refuses("activate"), (state, number)
        robot.command(0.5)  # to the other end of the range
        robot.let_pass(HEARD_S)
        call = robot.calls[-1]
        late = robot.last_change() - call
        moving += late > -MOVING_S
        print(f"{state} {number}: last change {1e3 * late:.1f} ms after the call")
        assert late <= WITHIN_S, (state, number)
        assert robot.client.trigger("servo_bridge/clear_e_stop").success
        robot.let_pass(0.5)
        assert robot.last_change() - call <= WITHIN_S, (state, number)
        robot.board.clear()
    assert len(robot.calls) == each
    assert state != "driving" or 2 * moving > each
    print(f"{state}: moving at {moving} of {each} calls")


@pytest.mark.parametrize("each", [1, pytest.param(40, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("loss", ["stopped", "killed", "line cut"])
def test_no_pulse_changes_where_the_bridge_is_lost_after_the_stop(
    tmp_path: Path, client: BridgeClient, start: Callable[..., NodeProcess], loss: str, each: int
) -> None:
    cut = threading.Event()  # both ways; the board keeps its power
    with EmulatedBoardPty(link=tmp_path / "board", line=lambda data: b"" if cut.is_set() else data) as board:
        words = bridge_words(port=board.link, autostart="activate")
        bridge = start(BRIDGE, *words)
        robot = Stopped(client, board, seed=len(loss))
        for number in range(each):
            if loss == "killed" and number:
                bridge = start(BRIDGE, *words)
            robot.activate()
            robot.command(WHOLE_MOVE_S)
            robot.get_to("driving")
            assert client.trigger("servo_bridge/e_stop").success
            answered = board.time_s
            if loss == "stopped":
                bridge.process.send_signal(signal.SIGSTOP)
            elif loss == "killed":
                bridge.end(signal.SIGKILL)
            else:
                robot.let_pass(0.02)  # the packet has left when the call is answered, and arrives then
                cut.set()
                board.reset_wired = (
                    False  # else the bridge, which opens the port again, switches the pulses off
                )
            robot.let_pass(3.0)  # silence leads to rest after two
            late = robot.last_change() - answered
            assert board.pulses[-1].start_s > board.time_s - 0.1, (loss, number)
            print(f"{loss} {number}: last change {1e3 * late:.1f} ms after the answer")
            assert late <= WITHIN_S, (loss, number)
            if loss != "killed":
                bridge.process.send_signal(signal.SIGCONT)
                cut.clear()
                board.reset_wired = True
                assert client.trigger("servo_bridge/clear_e_stop").success
                robot.let_pass(0.5)
                assert robot.last_change() <= answered + WITHIN_S, (loss, number)
            board.clear()
