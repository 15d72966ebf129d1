"""The node `simulator`: parameters, topics and services around the physics thread."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core import RobotDescription, Simulation
from softsim_core.errors import CommandError, SoftSimError, SolverDivergedError, listing
from softsim_core.scene import SceneCatalog
from softsim_core.warmup import cached_kernels
from softsim_ros.messages import step_profile
from softsim_ros.robot_node import RobotNode
from softsim_ros.runtime import run_node
from softsim_ros.simulator.bases import BaseTargets
from softsim_ros.simulator.commands import (
    named_command,
    position_command,
    trajectory_command,
    trajectory_delay,
)
from softsim_ros.simulator.health import NOT_LOADED, health
from softsim_ros.simulator.parameters import (
    StartParameters,
    checked_speed,
    clear_overrides,
    declare_allowed_code,
    declare_overrides,
    declare_parameters,
    declare_physics_again,
)
from softsim_ros.simulator.physics_thread import PhysicsThread
from softsim_ros.simulator.publications import Publications
from softsim_ros.simulator.pulls import Pulls
from softsim_ros.simulator.scene_files import SceneFiles
from softsim_ros.simulator.stage_statistics import stage_statistics

NODE_NAME = "simulator"
NAMED_DEPTH = 10
"""Commands by name that may wait: each may be for other joints."""

WATCH_PERIOD_S = 0.25
"""The scene's files are looked at this often, in [s]; one that was saved must rest that long."""


class Simulator(RobotNode):
    """Simulates one robot or scene in real time; made as RobotNode says.

    Raises:
        SoftSimError: the robot is not known, or a parameter is not allowed.
    """

    node_name = NODE_NAME
    changes_robot = True
    _physics: PhysicsThread | None = None
    _closed = False
    _applies_parameters = True

    def _begin(self, robot: RobotDescription) -> None:
        self._files = SceneFiles(robot)
        self._files.overrides = declare_overrides(self)
        self._scenes = SceneCatalog(self.named, declare_allowed_code(self))
        if self._files.overrides:
            robot = self._files.load()
        start = declare_parameters(self, robot, self.robot)
        simulation = self._build(start)
        self.joint_names = simulation.joint_names
        self._backend = simulation.backend
        self._start_parameters = start
        self._speed = start.speed
        self._publications = Publications(
            self,
            simulation,
            self.frames,
            mesh_rate=start.mesh_rate,
            publish_clock=start.publish_clock,
            marker_stress=start.marker_stress,
            overrides=self._files.overrides,
            scenes=self._scenes.names(),
        )
        self._physics = PhysicsThread(
            simulation,
            self._publications.publish,
            self.refuse,
            self.get_logger().error,
            self.get_logger().get_child("scene").info,
            start.speed,
        )
        self._stage_statistics = self.create_publisher(DiagnosticArray, "stage_statistics", 1)
        self._step_profile = self.create_publisher(Float64MultiArray, "step_profile", 1)
        self.create_subscription(Float64MultiArray, "position_controller/commands", self._on_command, 1)
        self.create_subscription(JointState, "joint_commands", self._on_joint_command, NAMED_DEPTH)
        self.create_subscription(JointTrajectoryMessage, "joint_trajectory", self._on_trajectory, 1)
        self.create_subscription(String, "keys", self._on_key, 10)
        self._pulls = Pulls(self, self._physics, self.frames, self.refuse)
        self._base_targets = BaseTargets(self, self._physics, self.refuse)
        for name, action in (
            ("reset", self._reset),
            ("step", self._step),
            ("save", self._save),
            ("load", self._load),
            ("start", self._start),
            ("reload", self._reload),
        ):
            self.create_service(Trigger, f"~/{name}", _answering(action))
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.add_on_set_parameters_callback(self._on_parameters)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        if start.watch:
            self.create_timer(WATCH_PERIOD_S, self._look_at_files, clock=steady)
        self._physics.start()
        self.get_logger().info(
            f"simulating {self.robot}: {len(simulation.positions)} nodes, {len(simulation.tets)} tetrahedra, "
            f"joints {listing(self.joint_names)}, step {simulation.dt:g} s, backend {simulation.backend}"
        )

    def _build(self, start: StartParameters) -> Simulation:
        """The simulation, with its kernels compiled: the first real step takes no longer than the others."""
        compiled, _ = cached_kernels()
        once = "" if compiled else "; its kernels are compiled first, once, one to two minutes"
        self.get_logger().info(f"building {self.robot}{once}")
        backend: Any = start.backend
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            trial = Simulation(dataclasses.replace(start.robot, controllers=()), backend=backend)
            with suppress(SolverDivergedError):  # the physics thread will meet it, stop there and say so
                trial.step()
            trial.von_mises()
            simulation = Simulation(start.robot, backend=backend)
        for sentence in dict.fromkeys(str(warning.message) for warning in caught):
            self.get_logger().warning(sentence)
        return simulation

    def close(self) -> None:
        """End the physics, then destroy the node; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._physics is not None:
            self._physics.close()
        self.destroy_node()

    @property
    def physics(self) -> PhysicsThread:
        """The thread that owns the simulation."""
        assert self._physics is not None
        return self._physics

    # --- commands -------------------------------------------------------------------------------------

    def _on_command(self, message: Float64MultiArray) -> None:
        try:
            self.physics.command(position_command(message, self.joint_names))
        except CommandError as error:
            self.refuse(str(error))

    def _on_joint_command(self, message: JointState) -> None:
        try:
            self.physics.command_named(named_command(message, self.joint_names, self._now_s()))
        except CommandError as error:
            self.refuse(str(error))

    def _now_s(self) -> float:
        """The time now in [s], on the clock that stamps what the simulator sends."""
        if self._start_parameters.publish_clock:
            return self.physics.status.time_s
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _on_trajectory(self, message: JointTrajectoryMessage) -> None:
        try:
            delay = trajectory_delay(message, self._now_s())
            self.physics.command(trajectory_command(message, self.joint_names), delay)
        except CommandError as error:
            self.refuse(str(error))

    def _on_key(self, message: String) -> None:
        """A key for the functions that the scene itself hung on keys."""
        try:
            self.physics.press_key(message.data)
        except Exception as error:  # a scene's own code may raise anything; the node must live on
            self.refuse(f"key {message.data!r}: {error}")

    # --- services -------------------------------------------------------------------------------------

    def _reset(self) -> str:
        self.physics.reset()
        paused = self.physics.status.paused
        return "back at the start of the scene" + ("; still paused" if paused else "")

    def _step(self) -> str:
        self.physics.step_once()
        return f"step {self.physics.status.steps} done"

    def _save(self) -> str:
        data = self.physics.call(lambda simulation: simulation.snapshot(), shows=False)
        return f"saved to {self._start_parameters.snapshots.write(self._snapshot_name(), data)}"

    def _load(self) -> str:
        snapshots, name = self._start_parameters.snapshots, self._snapshot_name()
        self.physics.restore(snapshots.read(name))
        self._take_over_tuning()
        return f"loaded from {snapshots.file(name)}"

    def _start(self) -> str:
        self.physics.play_start()
        return "start animation begun"

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        def pause() -> str:
            self.physics.pause(request.data)
            return "paused" if request.data else "running"

        response.success, response.message = _attempt(pause)
        return response

    def _snapshot_name(self) -> str:
        return str(self.get_parameter("snapshot").value)

    # --- another scene --------------------------------------------------------------------------------

    def _look_at_files(self) -> None:
        if self._files.saved():
            successful, sentence = _attempt(self._reload)
            if successful:  # a failure was logged by the physics
                self.get_logger().info(sentence)

    def _reload(self) -> str:
        """Load the scene's files anew and go on with it; with wrong ones the scene before stays, paused."""
        before, declared = self._start_parameters, False
        self._applies_parameters = False  # declaring sets them; the scene carries their values
        try:
            scene = self._files.load()
            declared = True
            after = declare_physics_again(self, scene, before)
            simulation = self._build(after)
        except Exception as error:
            if declared:
                self._start_parameters = declare_physics_again(self, before.robot, before)
            reason = str(error) if isinstance(error, SoftSimError) else f"{type(error).__name__}: {error}"
            sentence = f"{NOT_LOADED}{reason}"
            self.physics.stop(sentence)
            raise SoftSimError(sentence) from error
        finally:
            self._applies_parameters = True
        laid, known = self._files.overrides, self._scenes.names()
        show = partial(self._publications.show_scene, overrides=laid, scenes=known)
        self.physics.replace(simulation, show)
        self._start_parameters, self.joint_names = after, simulation.joint_names
        return f"loaded {scene.source}"

    def _change_scene(self, robot: str) -> None:
        """Go on with another robot or scene, in the same namespace; a wrong name or file changes nothing."""
        before = self._files
        self._files = SceneFiles(self._scenes.load(robot))
        try:
            self._reload()
        except SoftSimError:
            self._files = before
            raise
        clear_overrides(self)

    def _apply_overrides(self, overrides: str) -> None:
        """Begin the scene anew with other values laid over its files; wrong ones change nothing."""
        try:
            Simulation(self._files.try_overrides(overrides))  # what cannot be built must not stop what runs
        except Exception as error:
            reason = str(error) if isinstance(error, SoftSimError) else f"{type(error).__name__}: {error}"
            raise SoftSimError(f"overrides refused: {reason}") from error
        self._files.overrides = overrides
        self._reload()

    # --- parameters -----------------------------------------------------------------------------------

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Apply new values, whose types and ranges rclpy has checked; the first refusal stops."""
        if not self._applies_parameters:
            return SetParametersResult(successful=True)
        for parameter in parameters:
            successful, reason = _attempt(partial(self._apply, parameter))
            if not successful:
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _take_over_tuning(self) -> None:
        """Make the parameters tell what the loaded snapshot holds."""
        tunings = self._start_parameters.tunings

        def read(simulation: Simulation) -> dict[str, float | bool]:
            numbers = {name: tuning.read(simulation) for name, tuning in tunings.items()}
            return {**numbers, "enforce_limits": simulation.enforce_limits}

        values = self.physics.call(read, shows=False)
        self._applies_parameters = False
        try:
            self.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        finally:
            self._applies_parameters = True

    def _apply(self, parameter: Parameter) -> str:
        name, value = parameter.name, parameter.value
        if name in self._start_parameters.tunings:
            tuning, number = self._start_parameters.tunings[name], float(value)
            self.physics.call(lambda simulation: tuning.write(simulation, number), shows=False)
        elif name == "robot":
            self._change_scene(str(value))
        elif name == "snapshot":
            self._start_parameters.snapshots.file(str(value))
        elif name == "overrides":
            self._apply_overrides(str(value))
        elif name == "enforce_limits":
            self.physics.call(
                lambda simulation: setattr(simulation, "enforce_limits", bool(value)), shows=False
            )
        elif name == "speed":
            self._speed = checked_speed(float(value))
            self.physics.set_speed(self._speed)
        elif name == "mesh_rate":
            self._publications.mesh_rate = float(value)
        elif name == "marker_stress":
            self._publications.marker_stress = float(value)
        return ""

    # --- diagnostics ----------------------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        level, sentence, values = health(
            self.physics.status, self.physics.is_alive, self._speed, self._backend
        )
        self._publish_health(level, sentence, values)
        if self._stage_statistics.get_subscription_count():
            stamp, stages = self.get_clock().now().to_msg(), self.physics.status.speed.stages
            self._stage_statistics.publish(stage_statistics(stamp, self.robot, stages))
        if self._step_profile.get_subscription_count():
            self._step_profile.publish(step_profile(*self.physics.history.steps()))


def _attempt(action: Callable[[], str]) -> tuple[bool, str]:
    """Success and sentence of a service call."""
    try:
        return True, action()
    except SoftSimError as error:
        return False, str(error)


def _answering(
    action: Callable[[], str],
) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = _attempt(action)
        return response

    return answer


def main(args: Sequence[str] | None = None) -> int:
    """Run the simulator as a process; returns the exit code."""
    return run_node(Simulator, args)


if __name__ == "__main__":
    sys.exit(main())
