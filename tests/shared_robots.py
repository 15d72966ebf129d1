"""Simulated robots: one as the tests see it, and those that the files of a worker share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any

from node_processes import (
    Client,
    NodeProcess,
    ProcessGroup,
    parameter_words,
    reserved_domain,
    ros_environment,
)
from waiting import BUILD_S

SIMULATOR = "softsim_ros.nodes.simulator.simulator_node"


class Robot:
    """A simulator process seen through its topics and services."""

    def __init__(self, process: NodeProcess, client: Client) -> None:
        self.process, self.client = process, client

    def trigger(self, name: str) -> tuple[bool, str]:
        from std_srvs.srv import Trigger

        answer = self.client.call(Trigger, f"simulator/{name}")
        return answer.success, answer.message

    def pause(self, paused: bool) -> tuple[bool, str]:
        from std_srvs.srv import SetBool

        answer = self.client.call(SetBool, "simulator/pause", SetBool.Request(data=paused))
        return answer.success, answer.message

    def command(self, values: list[float]) -> None:
        from std_msgs.msg import Float64MultiArray

        self.client.publish("position_controller/commands", Float64MultiArray(data=values))

    def set_parameters(self, **values: Any) -> tuple[bool, str]:
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self.client.call(
            SetParametersAtomically,
            "simulator/set_parameters_atomically",
            SetParametersAtomically.Request(parameters=messages),
        ).result
        return result.successful, result.reason

    def get_parameters(self, names: Sequence[str]) -> dict[str, Any]:
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        request = GetParameters.Request(names=list(names))
        values = self.client.call(GetParameters, "simulator/get_parameters", request).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def get_parameter(self, name: str) -> Any:
        return self.get_parameters([name])[name]

    def warns(self, text: str) -> bool:
        return self.process.says(text)

    @cached_property
    def start_parameters(self) -> dict[str, Any]:
        """Values of the parameters that can be set, as they were when this was first asked for."""
        from rcl_interfaces.srv import DescribeParameters, ListParameters

        names = self.client.call(ListParameters, "simulator/list_parameters").result.names
        request = DescribeParameters.Request(names=names)
        found = self.client.call(DescribeParameters, "simulator/describe_parameters", request).descriptors
        return self.get_parameters([each.name for each in found if not each.read_only])

    def restore(self) -> None:
        """Bring it back to its start: parameters as they were, running, pose and physics reset."""
        # Another scene has other parameters, and these two are set one after the other.
        for names in (["robot"], ["overrides"], list(self.start_parameters)):
            now = self.get_parameters(names)
            changed = {
                name: self.start_parameters[name]
                for name in names
                if now[name] != self.start_parameters[name]
            }
            if changed:
                assert self.set_parameters(**changed) == (True, "")
        assert self.pause(False)[0]
        assert self.trigger("reset")[0]


class SharedRobot:
    """A simulator process with default parameters that runs on for several test modules.

    It has a ROS domain of its own: a module that uses it works in this domain, and sees no other robot.

    Args:
        name: Of the robot.
        folder: For its log and its state.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._reserved = ExitStack()
        self.domain = self._reserved.enter_context(reserved_domain())
        self._processes = ProcessGroup(folder)
        with ros_environment(self.domain, folder):
            self.process = self._processes(SIMULATOR, "--ros-args", *parameter_words(robot=name))
        assert self.process.says("simulating", BUILD_S), self.process.output
        client = Client(self.domain, name, self._processes)
        try:
            robot = Robot(self.process, client)
            self._start_parameters = robot.start_parameters
            assert robot.pause(True)[0]
        finally:
            client.close()

    @property
    def runs(self) -> bool:
        return self.process.process.poll() is None

    def seen_by(self, client: Client) -> Robot:
        """The robot for the tests of a module, with what it writes from now on."""
        robot = Robot(self.process, client)
        robot.start_parameters = self._start_parameters
        return robot

    def check(self) -> None:
        """Check that it still runs at the end of a module, and has written no traceback during it."""
        assert self.runs, self.process.state
        assert "Traceback" not in self.process.output, self.process.output
        self.process.forget_output()

    def end(self) -> None:
        self._processes.end()
        self._reserved.close()


class SharedRobots:
    """The shared robots of a worker.

    Args:
        new_folder: Makes a folder for a robot.
    """

    def __init__(self, new_folder: Callable[[], Path]) -> None:
        self._new_folder = new_folder
        self._robots: dict[str, SharedRobot] = {}

    def running(self, name: str) -> SharedRobot:
        """The robot of a name; it is started where it does not run."""
        if name not in self._robots or not self._robots[name].runs:
            self._robots[name] = SharedRobot(name, self._new_folder())
        return self._robots[name]

    def end(self) -> None:
        """End those that still run, in order and without a traceback."""
        for robot in self._robots.values():
            robot.end()
