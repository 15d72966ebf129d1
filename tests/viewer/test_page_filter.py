"""What a page may send: only values that a person could give to controls that are there."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser")

import msgspec
import numpy as np
import websockets
from node_processes import spin_until
from tcp_ports import free_port
from waiting import DEADLINE_S
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from softsim_ros.nodes.viewer import MOST_REFUSED, AccessRule, GuardedServer, passes

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

CLICK = {
    "type": "SceneNodeClickMessage",
    "name": "/edit/bodies/part",
    "instance_index": None,
    "ray_origin": [0.0, 1.0, 2.0],
    "ray_direction": [0.0, 0.0, -1.0],
    "screen_pos": [0.5, 0.5],
    "modifier": None,
    "owner": "",
}


class Controls:
    """A page with one control of each kind, and what was done to them."""

    def __init__(self, server: GuardedServer) -> None:
        gui = server.gui
        self.server, self.done = server, list[Any]()
        self.stop = gui.add_button("E-STOP")
        self.slider = gui.add_slider("slider", 0.0, 10.0, 0.1, 5.0)
        self.choice = gui.add_dropdown("choice", ("tripod", "gripper"))
        self.row = gui.add_button_group("row", ("run", "pause"))
        self.box = gui.add_checkbox("box", False)
        self.text = gui.add_text("text", "a")
        self.number = gui.add_number("number", 3, min=1, max=9)

        async def clicked(event: Any) -> None:
            self.done.append(event.target)

        self.stop.on_click(clicked)

    def passes(self, handle: Any, **updates: Any) -> bool:
        return self.takes(update(handle, **updates))

    def takes(self, raw: bytes | str) -> bool:
        return passes(raw, self.server._controls())


def update(handle: Any, **updates: Any) -> bytes:
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": updates})


@pytest.fixture
def controls() -> Iterator[Controls]:
    server = GuardedServer(AccessRule("127.0.0.1", free_port(), "secret"), "test")
    yield Controls(server)
    server.stop()


def test_values_that_a_person_could_give_pass(controls: Controls) -> None:
    for handle, value in (
        (controls.stop, True),
        (controls.slider, 0.0),
        (controls.slider, 10),
        (controls.choice, "gripper"),
        (controls.row, "pause"),
        (controls.box, True),
        (controls.text, "other"),
        (controls.number, 9),
    ):
        assert controls.passes(handle, value=value), (handle, value)
    for message in (CAMERA, CLICK):
        assert controls.takes(msgspec.msgpack.encode(message))


def test_other_values_do_not(controls: Controls) -> None:
    for handle, values in (
        (controls.stop, (3, "x", None, [])),
        (controls.slider, (-0.1, 10.1, "5", True, None, float("nan"), float("inf"), [5.0], b"abc")),
        (controls.choice, ("/tmp/evil.py", "", 0, None, ["tripod"])),
        (controls.row, ("format", 1)),
        (controls.box, (1, "true", None)),
        (controls.text, (20_001 * "x", 1, None)),
        (controls.number, (0, 10, "3")),
    ):
        for value in values:
            assert not controls.passes(handle, value=value), (handle, value)


@pytest.mark.parametrize("name", ["update_cb", "sync_cb", "removed", "props", "uuid", "disabled", "visible"])
def test_nothing_but_values_can_be_set(controls: Controls, name: str) -> None:
    assert not controls.passes(controls.stop, **{name: []})
    assert not controls.passes(controls.stop, value=True, **{name: []})


@pytest.mark.parametrize(
    "message",
    [
        {"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "y"},
        {"type": "FileTransferPart", "transfer_uuid": "y", "part_index": 0, "content": b"abc"},
        {"type": "ShareUrlRequest"},
        {"type": "GuiButtonHoldMessage", "uuid": "x", "frequency": 1.0},
        {"type": "RunJavascriptMessage", "source": "alert(1)"},
        {"type": "GuiUpdateMessage", "uuid": "no such control", "updates": {"value": 1}},
        {"type": "CommandTriggerMessage"},
        {"type": "CommandTriggerMessage", "uuid": "x", "more": 1},
        {"type": ["GuiUpdateMessage"]},
        {"type": "GetRenderResponseMessage", "payload": "aGVsbG8=", "render_uuid": "x"},
        {**CLICK, "ray_origin": [0.0, 1.0]},
        {**CLICK, "ray_direction": [0.0, float("nan"), 1.0]},
        {**CLICK, "name": 3},
        {**CLICK, "callback": "x"},
        {**CAMERA, "position": [0.0, 1.0]},
        {**CAMERA, "fov": float("nan")},
        {**CAMERA, "wxyz": [1e300, 0, 0, 0]},
        [1, 2],
        None,
    ],
)
def test_other_messages_do_not_pass(controls: Controls, message: Any) -> None:
    assert not controls.takes(msgspec.msgpack.encode(message))


def test_no_bytes_break_the_filter(controls: Controls) -> None:
    rng = np.random.default_rng(11)
    whole = update(controls.slider, value=3.0)
    assert not controls.takes("text")
    assert not controls.takes(b"\x91" * 100_000)
    for _ in range(2000):
        controls.takes(rng.bytes(int(rng.integers(0, 60))))
        broken = bytearray(whole)
        broken[int(rng.integers(len(whole)))] = int(rng.integers(256))
        controls.takes(bytes(broken))


# --- over the socket -----------------------------------------------------------------------------------


def talk(controls: Controls, action: Callable[[Any], Any]) -> Any:
    """What comes of a conversation with the server, as a page with the cookie has it."""
    rule = controls.server.rule

    async def run() -> Any:
        async with connect(
            f"ws://127.0.0.1:{rule.port}",
            subprotocols=[Subprotocol("viser-v1.1.1")],
            max_size=None,
            additional_headers={"Cookie": f"{rule.cookie}={rule.token}"},
        ) as connection:
            return await action(connection)

    return asyncio.run(run())


def test_the_e_stop_cannot_be_disarmed(controls: Controls) -> None:
    async def attack(connection: Any) -> None:
        for name in ("update_cb", "sync_cb", "removed", "is_button"):
            await connection.send(update(controls.stop, **{name: []}))
        await connection.send(update(controls.slider, value=b"abc"))
        await connection.send(b"\xc1 no message")

    talk(controls, attack)

    async def press(connection: Any) -> None:
        await connection.send(msgspec.msgpack.encode(CAMERA))  # viser knows a page by its camera
        await asyncio.to_thread(spin_until, controls.server.get_clients)
        await connection.send(update(controls.stop, value=True))
        await asyncio.to_thread(spin_until, lambda: controls.done)

    talk(controls, press)
    assert controls.done == [controls.stop]
    assert controls.slider.value == 5.0


@pytest.mark.slow
def test_uploads_are_kept_nowhere_and_their_page_is_left(controls: Controls) -> None:
    start = {
        "type": "FileTransferStartUpload",
        "source_component_uuid": controls.slider._impl.uuid,
        "transfer_uuid": "t",
        "filename": "f",
        "mime_type": "text/plain",
        "part_count": 10**6,
        "size_bytes": 10**12,
    }
    part = {"type": "FileTransferPart", "source_component_uuid": None, "transfer_uuid": "t", "content": b"."}

    async def upload(connection: Any) -> int:
        await connection.send(msgspec.msgpack.encode(start))
        try:
            for index in range(MOST_REFUSED):
                await connection.send(msgspec.msgpack.encode({**part, "part_index": index}))
            while True:
                await connection.recv()
        except websockets.exceptions.ConnectionClosed as error:
            return 0 if error.rcvd is None else error.rcvd.code

    assert talk(controls, upload) == 1008
    assert controls.server.gui._current_file_upload_states == {}


STATION = """
import sys
from softsim_ros.nodes.viewer import AccessRule, GuardedServer
server = GuardedServer(AccessRule("127.0.0.1", int(sys.argv[1]), "secret"), "test")
print("ready", flush=True)
sys.stdin.readline()
server.stop()
"""


@pytest.mark.slow
def test_broken_and_half_open_connections_say_nothing_and_keep_nobody_out() -> None:
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-c", STATION, str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        for line in (b"nonsense\r\n\r\n", b"GET /\r\n\r\n", b"\0" * 2000, b"GET / HTTP/1.1\r\nHost\r\n\r\n"):
            for _ in range(20):
                with socket.create_connection(("127.0.0.1", port), DEADLINE_S) as stranger:
                    stranger.sendall(line)
        idle = [socket.create_connection(("127.0.0.1", port), DEADLINE_S) for _ in range(200)]
        for each in idle:
            each.close()

        def served() -> bool:
            request = f"GET /?token=secret HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
            with (
                suppress(ConnectionError),
                socket.create_connection(("127.0.0.1", port), DEADLINE_S) as friend,
            ):
                friend.sendall(request.encode())
                return friend.recv(100).startswith(b"HTTP/1.1 303")
            return False

        assert spin_until(served)
        output, _ = process.communicate("end\n", timeout=DEADLINE_S)
    finally:
        process.kill()
        process.wait()
    assert output == ""


def test_the_sliders_of_layers_and_fibres_are_guarded_as_all_are(controls: Controls) -> None:
    pytest.importorskip("rclpy")
    from softsim_core import load_scene
    from softsim_ros.nodes.viewer import Inbox, TuneTab

    parameters: Any = SimpleNamespace(follow=lambda names, on_values: None)
    TuneTab(controls.server.gui, Inbox(), load_scene("pneu_finger"), parameters)
    sliders = {each.label: each for each in controls.server._controls().values()}
    for label, lower, upper in (
        ("Young modulus of paper [MPa]", 100.0, 4000.0),
        ("Stiffness in tension of thread [kPa]", 100.0, 4000.0),
        ("Poisson ratio of paper", 0.0, 0.495),
    ):
        for value in (lower, 0.5 * (lower + upper), upper):
            assert controls.passes(sliders[label], value=value)
        for value in (lower - 0.1, upper + 0.1, float("nan"), "1", True, None):
            assert not controls.passes(sliders[label], value=value)
        assert not controls.passes(sliders[label], value=upper, max=1e9)
