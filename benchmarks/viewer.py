"""Measure the cost of the web viewer: its processor time, and the simulator's step time with it."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import IO, Final

import numpy as np

from benchmarks.process import (
    NODE_MODULE,
    Listener,
    ProcessError,
    end_process,
    resident_mb,
    wait_for_steps,
)
from softsim_core.base import Placement, open_in_place, python_command, start_process, write_file
from softsim_core.physics.mesh import SurfaceMesh, read_surface, write_surface
from softsim_core.scene.io import config_file, find_config
from softsim_ros.cli.running import NODES

ROBOT: Final = "tripod"
"""Name of the simulated robot, and its namespace."""

VIEWER_MODULE: Final = NODES["viewer"].module
CORE_SHARE_LIMIT: Final = 0.10
"""Largest fraction of a core that the viewer may need with one browser at 30 frames per second."""

STEP_GROWTH_LIMIT: Final = 0.05
"""Largest growth of the simulator's processor time per step while a browser watches."""

PAIRS: Final = 4
SETTLE_S: Final = 3.0


QUANTITIES: Final = {
    "cpu_ms_per_step": "processor time of a step",
    "step_ms": "wall time of a step",
    "publishing_ms": "wall time of publishing",
}
"""Compared quantities, by name in the simulator's diagnostics; wall time includes other programs."""


@dataclass(frozen=True)
class Growth:
    """A mean over each second, without and with viewer and browser.

    Attributes:
        alone, watched: One value per second in [ms], at least one each.
    """

    alone: Sequence[float]
    watched: Sequence[float]

    @property
    def of_median(self) -> float:
        """Relative growth of the median second."""
        return median(self.watched) / median(self.alone) - 1.0

    @property
    def of_quietest(self) -> float:
        """Relative growth of the smallest value."""
        return min(self.watched) / min(self.alone) - 1.0

    def line(self) -> str:
        """Return the values as text."""
        return (
            f"median {median(self.alone):.3f} and {median(self.watched):.3f} ms "
            f"({100.0 * self.of_median:+.1f} %), "
            f"smallest {min(self.alone):.3f} and {min(self.watched):.3f} ms "
            f"({100.0 * self.of_quietest:+.1f} %)"
        )


@dataclass(frozen=True)
class ViewerFigures:
    """Results of the measurement.

    Attributes:
        vertices: Vertices of the visible surface.
        core_share: Processor time of the viewer over wall time, [-].
        megabytes_s: Data rate to one browser, in [MB/s].
        memory_mb: Resident memory of the viewer in [MB].
        steps: Growth of each quantity of a step by its name in `QUANTITIES`.
    """

    vertices: int
    core_share: float
    megabytes_s: float
    memory_mb: float
    steps: Mapping[str, Growth]

    @property
    def growth(self) -> float:
        """Relative growth of the processor time of a step."""
        return self.steps["cpu_ms_per_step"].of_median

    @property
    def missed(self) -> bool:
        """Whether a limit is exceeded."""
        return self.core_share > CORE_SHARE_LIMIT or self.growth > STEP_GROWTH_LIMIT

    def lines(self) -> list[str]:
        """Return the figures as text."""
        return [
            f"viewer, {self.vertices} vertices at 30 Hz, one browser: "
            f"{100.0 * self.core_share:.1f} % of a core (limit {100.0 * CORE_SHARE_LIMIT:.0f}), "
            f"{self.memory_mb:.0f} MB, {self.megabytes_s:.2f} MB/s",
            f"the simulator, alone and watched; its step may take {100.0 * STEP_GROWTH_LIMIT:.0f} % more "
            "processor time in the median:",
            *(f"  {QUANTITIES[name]}: {growth.line()}" for name, growth in self.steps.items()),
        ]


def subdivide_surface(surface: SurfaceMesh) -> SurfaceMesh:
    """Return the surface with each triangle divided into four at the midpoints of its edges."""
    triangles = surface.triangles
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    a, b, c = triangles.T
    ab, bc, ca = len(surface.points) + number.reshape(3, -1)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    points = np.concatenate([surface.points, surface.points[unique].mean(axis=1)])
    return SurfaceMesh(points, np.concatenate([np.stack(part, axis=1) for part in parts]), surface.name)


def measure_viewer(seconds: float = 6.0) -> ViewerFigures:
    """Run the Tripod on the mid mesh with a visible surface of 2400 vertices, alone and watched in turn.

    Args:
        seconds: Duration of each turn in [s].

    Raises:
        ProcessError: a process did not run.
    """
    domain = 60 + os.getpid() % 40
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        log = stack.enter_context(open_in_place(folder / "log.txt", "w"))
        surface = subdivide_surface(read_surface(config_file("meshes/tripod_mid.stl"), Placement()))
        write_surface(folder / "fine.stl", surface)
        robot = write_file(
            folder / "tripod_watched.yaml",
            f"extends: {find_config('tripod_mid')}\n"
            "bodies:\n  - name: silicone\n    surface: {file: fine.stl}\n",
        )
        simulator = _start(NODE_MODULE, log, environment, f"robot:={robot}")
        stack.callback(end_process, simulator)
        listener = stack.enter_context(Listener(domain, f"/{ROBOT}", everything=False))
        wait_for_steps(simulator, listener, 300)
        alone: list[dict[str, float]] = []
        watched: list[dict[str, float]] = []
        costs: list[tuple[float, float, float]] = []
        for _ in range(PAIRS):
            alone += _steps(listener, seconds)
            costs.append(_watch_once(listener, watched, log, environment, seconds))
    return ViewerFigures(
        len(surface.points),
        median(cost[0] for cost in costs),
        median(cost[1] for cost in costs),
        max(cost[2] for cost in costs),
        {
            name: Growth([each[name] for each in alone], [each[name] for each in watched])
            for name in QUANTITIES
        },
    )


def _start(module: str, log: IO[str], environment: dict[str, str], *settings: str) -> subprocess.Popen[bytes]:
    parameter_words = [word for setting in settings for word in ("-p", setting)]
    return start_process(
        python_command(module, "--ros-args", *parameter_words),
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        env=environment,
        start_new_session=True,
    )


def _steps(listener: Listener, seconds: float) -> list[dict[str, float]]:
    """Return the simulator's diagnostics, one per second, over some seconds from now."""
    first = len(listener.reports) + 1  # the next report still covers the time before
    threading.Event().wait(seconds)
    return list(listener.reports[first:])


def _watch_once(
    listener: Listener,
    watched: list[dict[str, float]],
    log: IO[str],
    environment: dict[str, str],
    seconds: float,
) -> tuple[float, float, float]:
    """Return fraction of a core, MB/s to the browser, and memory in [MB] of a viewer with one browser."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    viewer = _start(VIEWER_MODULE, log, environment, f"robot:={ROBOT}", f"port:={port}", "no_token:=true")
    browser = Browser(port)
    try:
        browser.start()
        threading.Event().wait(SETTLE_S)
        began, used, received = time.monotonic(), processor_s(viewer.pid), browser.received
        watched += _steps(listener, seconds)
        elapsed = time.monotonic() - began
        share = (processor_s(viewer.pid) - used) / elapsed
        return share, (browser.received - received) / elapsed / 1e6, resident_mb(viewer.pid)
    finally:
        browser.close()
        end_process(viewer)


def processor_s(pid: int) -> float:
    """Return the processor time that a process has used, in [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Browser:
    """The browser's end of the connection; it counts received data and draws nothing."""

    def __init__(self, port: int) -> None:
        self._port, self.received = port, 0
        self._end = threading.Event()
        self._connected = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)

    def start(self, within_s: float = 30.0) -> None:
        """Connect, and wait until the server is available.

        Raises:
            ProcessError: it did not start in time.
        """
        self._thread.start()
        if not self._connected.wait(within_s):
            raise ProcessError(f"the viewer did not serve its page within {within_s:g} s")

    def close(self) -> None:
        """Close the connection."""
        self._end.set()
        self._thread.join(5.0)

    async def _run(self) -> None:
        import viser
        from websockets.asyncio.client import connect
        from websockets.exceptions import WebSocketException
        from websockets.typing import Subprotocol

        protocol = Subprotocol(f"viser-v{viser.__version__}")
        while not self._end.is_set():
            try:
                address = f"ws://127.0.0.1:{self._port}"
                async with connect(address, subprotocols=[protocol], max_size=None) as connection:
                    self._connected.set()
                    while not self._end.is_set():
                        data = await asyncio.wait_for(connection.recv(), 5.0)
                        self.received += len(data)
            except (OSError, WebSocketException, asyncio.TimeoutError):
                await asyncio.sleep(0.2)
