"""The viewer of `softsim up` in its own process, so that it cannot slow down the physics."""

from __future__ import annotations

import contextlib
import importlib.util
import signal
import subprocess
import threading
import time
from typing import IO, Final, NamedTuple

from softsim_core.base import install_command, python_command, start_process
from softsim_node import ending

ANNOUNCED: Final = "viewer: "
"""First word of the line in which the viewer prints its address."""

START_WITHIN_S: Final = 60.0
END_WITHIN_S: Final = 5.0
LOOK_S: Final = 0.1


class PageChoice(NamedTuple):
    """IP address and port of the page; cheap light for browsers without GPU; no secret on this machine."""

    host: str
    port: int
    lite: bool = False
    no_token: bool = False


class WebPage(contextlib.AbstractContextManager["WebPage"]):
    """A viewer process; leaving the `with` block ends it.

    Args:
        robot: Name of the robot or scene, as the viewer's parameter `robot`.
        namespace: Namespace of the robot, without slashes at its ends.
        choice: Address and appearance.
    """

    def __init__(self, robot: str, namespace: str, choice: PageChoice) -> None:
        self._settled = threading.Event()
        self._address, self._last = "", "it ended without a word"
        self._again = f"softsim run viewer --ros-args -r __ns:=/{namespace} -p robot:={robot}"
        self._process: subprocess.Popen[str] | None = None
        if importlib.util.find_spec("viser") is None:
            self._last = f"viser is not installed ({install_command('viewer')})"
            self._settled.set()
            return
        parameters = {"robot": robot, **choice._asdict()}  # YAML reads False as false
        parameter_words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        module = "softsim_ros.nodes.viewer.viewer_node"
        self._process = start_process(
            python_command(module, "--ros-args", "-r", f"__ns:=/{namespace}", *parameter_words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C ends the robot first, the page last
        )
        threading.Thread(target=self._listen, args=(self._process.stdout,), daemon=True).start()

    def _listen(self, output: IO[str]) -> None:
        """Read all output, since a full pipe would block the process."""
        for line in output:
            if line.startswith(ANNOUNCED) and not self._address and "http://" in line:
                self._address = line.removeprefix(ANNOUNCED).strip()
                self._settled.set()
            elif line.strip():
                self._last = line.strip().removeprefix(ANNOUNCED)
        self._settled.set()

    def notice(self) -> str:
        """Return a message with the address, or with the reason why there is no page; wait until it is known.

        Return an empty string if this process is to end before. Call it again for the present message, since
        a page may end before the robot.
        """
        end = time.monotonic() + START_WITHIN_S
        while not (self._settled.wait(LOOK_S) or ending.asked or time.monotonic() > end):
            pass
        if not self._settled.is_set():
            if ending.asked:
                return ""
            self._last = f"it did not start within {START_WITHIN_S:g} s"
        if not self._address:
            return f"no web page: {self._last}"
        if self._process is not None and self._process.poll() is not None:
            return f"the web page has ended, the robot continues; another page: {self._again}"
        return f"open {self._address} in a browser"

    def __exit__(self, *_: object) -> None:
        """End the process."""
        process = self._process
        if process is None or process.poll() is not None:
            return
        process.send_signal(signal.SIGINT)
        try:
            process.wait(END_WITHIN_S)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()
