"""Texts that a peer may set while a node runs: which there are, and that none of them opens a file."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from foreign_files import Watch, bait, references, watch  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

import servo_bridge.executables  # noqa: E402
import softsim_ros.executables  # noqa: E402
from servo_bridge.nodes import ServoBridge  # noqa: E402
from softsim_node import parameters_of  # noqa: E402
from softsim_ros.nodes.inverse import PathFollower  # noqa: E402
from softsim_ros.nodes.simulator import Simulator  # noqa: E402

__all__ = ["bait", "watch"]  # fixtures

SETTABLE = {
    "simulator": {"robot", "overrides", "snapshot"},
    "path_follower": {"file"},
    "servo_bridge": {"imu_frame"},
}
"""Texts that may be anything and may change; a test below sets each of them to names of files."""


@pytest.fixture
def context(ros_domain: int) -> Iterator[Context]:
    own = Context()
    own.init(args=[], domain_id=ros_domain)
    yield own
    own.try_shutdown()


def programs() -> list[Any]:
    """Of all executables of the suite."""
    sources = map(inspect.getsource, (servo_bridge.executables, softsim_ros.executables))
    modules = re.findall(r'run_module(?:\(|, )"([\w.]+)"\)', "".join(sources))
    return [importlib.import_module(each).PROGRAM for each in modules]


def test_no_other_text_can_be_set() -> None:
    found: dict[str, set[str]] = {}
    for program in programs():
        for settings in program.settings:
            for name, value, about in parameters_of(settings):
                if isinstance(value, str) and not about.fixed and not about.choices:
                    found.setdefault(program.name, set()).add(name)
    assert found == SETTABLE


@pytest.mark.slow
@pytest.mark.parametrize("node_name", SETTABLE)
def test_no_text_opens_a_file(
    node_name: str, watch: Watch, bait: Path, context: Context, tmp_path: Path
) -> None:
    (bait / "circle.csv").write_text("time,x,y,z\n")  # as one of the suite is called
    fixed: dict[str, set[str]] = {"servo_bridge": {"robot", "port", "calibration", "protocol"}}
    if node_name == "servo_bridge":
        node: Any = ServoBridge(context=context, namespace="tripod")
    elif node_name == "path_follower":
        node = PathFollower("tripod", context=context)
    else:
        folder = Parameter("snapshot_folder", value=str(tmp_path / "snapshots"))
        node = Simulator("held_centre", context=context, parameter_overrides=[folder])
    try:
        for name in SETTABLE[node_name] | fixed.get(node_name, set()):
            for text in (*references(bait, 7, 8), "circle.csv", "circle"):
                with watch.on(bait) as seen:
                    refused = not node.set_parameters([Parameter(name, value=text)])[0].successful
                    if node_name == "servo_bridge":
                        node.trigger_configure()  # reads what they name
                assert seen == [], (name, text)
                assert refused or name not in fixed.get(node_name, ())
    finally:
        node.destroy_node() if node_name != "simulator" else node.close()
