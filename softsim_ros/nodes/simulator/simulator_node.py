"""The node `simulator`: parameters, topics and services around the physics thread."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import Trigger

from softsim_core import RobotDescription
from softsim_core.base import SoftSimError, listing
from softsim_core.scene import BodyDescription, SceneCatalog
from softsim_core.scene.building import Body
from softsim_core.scene.io import folders_of
from softsim_node import (
    BackgroundWorker,
    LiveParameters,
    ParameterError,
    Program,
    StateTopics,
    declare,
    reuse_freed_memory,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, RobotNode
from softsim_ros.messages import ERROR, OK, WARN, step_profile
from softsim_ros.nodes.simulator.inputs import CommandInputs, Pulls, PullSettings
from softsim_ros.nodes.simulator.parameters import (
    SCENE,
    SceneSettings,
    SimulatorSettings,
    TuningParameters,
    check_speed,
)
from softsim_ros.nodes.simulator.physics_thread import PhysicsStatus, PhysicsThread
from softsim_ros.nodes.simulator.publications import Publications, stage_statistics
from softsim_ros.nodes.simulator.scene_editing import Running, SceneEditing, SceneWriter
from softsim_ros.nodes.simulator.scene_files import (
    Attempt,
    CompiledLater,
    NextScene,
    SceneBuilder,
    SceneFiles,
    reason,
)
from softsim_ros.nodes.simulator.services import (
    SnapshotFolder,
    create_run_services,
    create_snapshot_services,
    default_name,
)
from softsim_ros.nodes.simulator.spawning import Spawner, Spawnings
from softsim_ros.nodes.simulator.standard_services import StandardServices

SLOW = 0.95
"""Below this fraction of the requested speed the simulator reports that it is slow."""

NOT_LOADED: Final = "scene not loaded: "
"""First words of a fault caused by a scene file; the physics of the previous scene is intact."""


def memory_mb() -> float:
    """Return the resident memory of this process in [MB]; 0 where /proc does not report it."""
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return float(line.split()[1]) / 1024.0
    except OSError:
        pass
    return 0.0


def health(status: PhysicsStatus, alive: bool, speed: float) -> tuple[bytes, str, dict[str, object]]:
    """Return level, message and values of the diagnostics.

    `alive` is whether the physics thread runs, `speed` the requested one in simulated seconds per wall
    second; 0 is as fast as possible.
    """
    factor = status.speed.real_time_factor
    state = "paused" if status.paused else "running"
    level, message = OK, state
    if not alive:
        level, message, state = ERROR, "the physics thread has ended; restart the simulator", "ended"
    elif status.fault:
        level, message, state = ERROR, status.fault, "stopped"
    elif status.contacts is not None and status.contacts.unsolved:
        level, message = WARN, status.contacts.complaint
    elif status.inverted_elements:
        count = status.inverted_elements
        subject = "element is" if count == 1 else "elements are"
        level, message = WARN, f"{count} {subject} inside out; reduce dt, the load, or the pull on them"
    elif status.fallbacks:
        level, message = WARN, status.fallbacks.complaint
    elif not status.paused and 0.0 < factor < SLOW * speed:
        level, message = WARN, f"slower than asked: {factor:.2f} of {speed:g} times real time"
    values: dict[str, object] = {
        "state": state,
        "real_time_factor": factor,
        "steps_per_second": status.speed.steps_per_second,
        "steps": status.steps,
        "cpu_ms_per_step": status.speed.cpu_ms,
        "time_s": status.time_s,
        "dt_s": status.dt,
        "time_behind_s": status.late_s,
        "scene": "not loaded" if status.fault.startswith(NOT_LOADED) else "loaded",
        "trajectory": "running" if status.trajectory else "none",
        "clamped_commands": status.clamped_commands,
        "refused_commands": status.refused_commands,
        "backend": status.backend,
        "inverted_elements": status.inverted_elements,
        **status.fallbacks.as_values(),
        "memory_mb": memory_mb(),
    }
    if status.contacts is not None:
        values.update(status.contacts.as_values())
    for stage, time_ms in status.speed.stages_ms.items():
        values[f"{stage}_ms"] = time_ms
    return level, message, values


NODE_NAME = "simulator"
WATCH_PERIOD_S = 0.25
"""Period in [s] of checks of the scene's files; a saved file must stay unchanged for one period."""


class Simulator(RobotNode):
    """Simulates one robot or scene in real time; created as RobotNode describes.

    Raises:
        SoftSimError: the robot is unknown, or a parameter is not allowed.
    """

    node_name = NODE_NAME
    _physics: PhysicsThread | None = None
    _inputs: CommandInputs | None = None
    _standard: StandardServices | None = None
    _editing: SceneEditing | None = None
    _later: CompiledLater | None = None
    _closed = False

    def _begin(self, robot: RobotDescription) -> None:
        reuse_freed_memory()
        self._background = BackgroundWorker("another scene is being loaded")
        self._attempt: Attempt | None = None
        first = declare(self, SceneSettings(robot=self.robot_parameter))
        self._files = SceneFiles(robot)
        self._files.overrides = first.overrides
        self._scenes = SceneCatalog(self.named, folders_of(first.allow_code))
        if first.overrides:
            robot = self._files.load()
            self._files.take_over(robot, first.overrides, ())
        self._live = LiveParameters(
            self,
            SimulatorSettings.of(robot, first, default_name(robot, self.get_namespace())),
            check=self._check_parameters,
            apply=self._apply_parameters,
        )
        start = self._live.values
        check_speed(start.speed)
        self._snapshots = SnapshotFolder(Path(start.snapshot_folder))
        self._snapshots.file(start.snapshot)
        self._tuning = TuningParameters(self, lambda change: self.physics.call(change, shows=False))
        self._builder = SceneBuilder(lambda: self._live.values, self.get_logger())
        simulation = self._builder.build(self._tuning.declare(robot))
        self.joint_names = simulation.joint_names
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
        self._inputs = CommandInputs(
            self, self._physics, lambda: self.joint_names, self._now_s, start.follow_joint_states
        )
        self.create_subscription(String, "keys", self._on_key, 10)
        self._pulls = Pulls(self, self._physics, self.frames)
        create_run_services(self, self._physics, lambda: self._state_topics.refresh())
        create_snapshot_services(
            self, self._physics, self._snapshots, lambda: self._live.values.snapshot, self._take_over_tuning
        )
        self.create_service(Trigger, "~/reload", self._on_reload, callback_group=self._waiting)
        spawner = Spawner(self._scenes, self._exchange, self._background.run, lambda: self._files.spawned)
        if start.editing:
            running = Running(lambda: self._files, self._bodies, self._background.run, self._go_on_with)
            writer = SceneWriter(self.named.values(), self._scenes.start_folder)
            self._editing = SceneEditing(self, running, self._builder, writer)
        self._standard = StandardServices(self, self._physics, self._publications.stamp, spawner)
        steady_timer(self, 1.0, self._publish_diagnostics)
        if start.watch:
            steady_timer(self, WATCH_PERIOD_S, self._look_at_files, callback_group=self._waiting)
        self._physics.start()
        if self._builder.waits(robot):
            as_its_file_says = None if first.overrides else robot.source
            self._later = CompiledLater(self._physics, as_its_file_says, self.get_logger())
            self._later.start()
        self._state_topics = StateTopics(
            self,
            {
                "simulator/paused": lambda: Bool(data=self.physics.status.paused),
                "simulator/faulted": lambda: Bool(
                    # also if the thread has ended before the node
                    data=bool(self.physics.status.fault) or not (self.physics.is_alive or self._closed)
                ),
            },
        )
        elements = sum(len(group.cells) for group in simulation.model.filling)
        self.get_logger().info(
            f"simulating {self.robot}: {len(simulation.positions)} nodes, {elements} elements, "
            f"joints {listing(self.joint_names)}, step {simulation.dt:g} s, backend {simulation.backend}"
        )

    def close(self) -> None:
        """Stop the physics, then destroy the node; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._later is not None:
            self._later.close()
        self._background.close()
        if self._physics is not None:
            self._physics.close()
        if self._inputs is not None:
            self._inputs.action.close()
        if self._standard is not None:
            self._standard.close()
        self.destroy_node()

    @property
    def physics(self) -> PhysicsThread:
        """The thread that owns the simulation."""
        assert self._physics is not None
        return self._physics

    # --- commands -------------------------------------------------------------------------------------

    def _now_s(self) -> float:
        """Return the current time in [s], on the clock that stamps the simulator's messages."""
        if self._live.values.publish_clock:
            return self.physics.status.time_s
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _on_key(self, message: String) -> None:
        """Pass a key to the functions that the scene's own code registered for it."""
        try:
            self.physics.press_key(message.data)
        except Exception as error:  # a scene's own code may raise anything; the node must keep running
            self.refuse(f"key {message.data!r}: {error}")

    # --- another scene --------------------------------------------------------------------------------

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Create a service as GuardedNode does.

        A request to set parameters that load another scene is answered once that scene has been built.
        """
        setters = (SetParameters, SetParametersAtomically)
        if srv_type in setters:
            callback, options = self._built_first(callback), {**options, "callback_group": self._waiting}
        return super().create_service(srv_type, srv_name, callback, **options)

    @cached_property
    def _waiting(self) -> ReentrantCallbackGroup:
        """Callback group of callbacks that wait for background work.

        In the node's own group, which is exclusive, all other callbacks would wait with them.
        """
        return ReentrantCallbackGroup()

    def _built_first(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        async def answer(request: Any, response: Any) -> Any:
            requests = [
                (each.name, each.value.string_value) for each in request.parameters if each.name in SCENE
            ]
            if len(requests) == 1:
                try:
                    built = await self._background.run(partial(self._prepare, *requests[0]))
                    self._attempt = Attempt(requests[0], built, None)
                except Exception as error:
                    self._attempt = Attempt(requests[0], None, error)
            try:
                return callback(request, response)
            finally:
                self._attempt = None

        return answer

    async def _look_at_files(self) -> None:
        if not self._background.is_busy and self._files.has_changed_on_disk():
            with suppress(SoftSimError):  # logged by the physics
                self.get_logger().info(await self._reload())

    async def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, await self._reload()
        return response

    async def _reload(self) -> str:
        """Reload the scene's files and continue with them.

        Raises:
            SoftSimError: the files are wrong; the previous scene stays, paused.
        """
        try:
            following = await self._background.run(partial(self._builder.build_again, self._files))
        except Exception as error:
            message = f"{NOT_LOADED}{reason(error)}"
            self.physics.stop(message)
            raise SoftSimError(message) from error
        self._go_on_with(following)
        return f"loaded {following.scene.source}"

    def _prepare(self, name: str, value: str) -> NextScene:
        """Return the scene that a value of `robot` or `overrides` asks for, ready to run.

        Nothing that runs changes.
        """
        if name == "robot":
            return self._builder.build_named(value, self._scenes)
        return self._builder.build_overridden(value, self._files)

    def _go_on_with(self, following: NextScene) -> None:
        try:
            self._tuning.declare(following.scene)
        except ParameterError:  # values given at the start fit another material
            self._tuning.declare(following.scene, uses_overrides=False)
        self._tuning.tune(following.simulation)
        self._replace(following)
        self.joint_names = following.simulation.joint_names

    async def _exchange(self, change: Callable[[RobotDescription, Spawnings], Spawnings]) -> None:
        """Continue the same scene with other spawned bodies, from its state at that time."""
        following = await self._background.run(lambda: self._builder.with_spawned(self._files, change))
        self._replace(following, goes_on=True)

    def _replace(self, following: NextScene, *, goes_on: bool = False) -> None:
        laid, scene_names = following.overrides, self._scenes.names()
        show = partial(self._publications.show_scene, overrides=laid, scenes=scene_names)
        self.physics.replace(following.simulation, show, goes_on=goes_on)
        self._files = following.files
        self._files.take_over(following.scene, laid, following.spawned, following.text)
        if self._editing is not None:
            self._editing.scene_replaced()

    def _bodies(self) -> list[tuple[BodyDescription, Body]]:
        return self.physics.call(
            lambda simulation: list(zip(simulation.scene.bodies, simulation.bodies, strict=True)), shows=False
        )

    # --- parameters -----------------------------------------------------------------------------------

    def _check_parameters(self, names: frozenset[str], settings: SimulatorSettings) -> None:
        check_speed(settings.speed)
        if "snapshot" in names:
            self._snapshots.file(settings.snapshot)
        if names >= SCENE:
            raise ParameterError("robot and overrides are set one after the other")
        for name in names & SCENE:
            requested = (name, settings.robot if name == "robot" else settings.overrides)
            if self._attempt is None or self._attempt.request != requested:
                self._attempt = Attempt(requested, self._prepare(*requested), None)
            if self._attempt.error is not None:
                error, self._attempt = self._attempt.error, None
                raise error

    def _apply_parameters(self, names: frozenset[str], settings: SimulatorSettings) -> None:
        attempt, self._attempt = self._attempt, None
        if names & SCENE and attempt is not None and attempt.built is not None:
            self._go_on_with(attempt.built)
            if "robot" in names:
                self._live.store(overrides="")
        if "enforce_limits" in names:
            limits = settings.enforce_limits
            self.physics.call(lambda run: setattr(run, "enforce_limits", limits), shows=False)
        if "speed" in names:
            self.physics.set_speed(settings.speed)
        self._publications.set_mesh_rate(settings.mesh_rate)
        self._publications.marker_stress = settings.marker_stress

    def _take_over_tuning(self) -> None:
        """Set the parameters to the values of the loaded snapshot."""
        values, limits = self.physics.call(
            lambda simulation: (self._tuning.read(simulation), simulation.enforce_limits), shows=False
        )
        self._tuning.store(**values)
        self._live.store(enforce_limits=limits)

    # --- diagnostics ----------------------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        if self._inputs is not None:
            self._inputs.action.look()
        level, message, values = health(self.physics.status, self.physics.is_alive, self._live.values.speed)
        self._publish_health(level, message, values)
        if self._stage_statistics.get_subscription_count():
            stamp, stages = self.get_clock().now().to_msg(), self.physics.status.speed.stages
            self._stage_statistics.publish(stage_statistics(stamp, self.robot, stages))
        if self._step_profile.get_subscription_count():
            self._step_profile.publish(step_profile(*self.physics.history.steps()))


PROGRAM = Program(
    name="simulator",
    about="Simulates one robot or scene in real time.",
    settings=(SimulatorSettings(), FrameSettings(), PullSettings()),
    more="Material and damping of the scene are parameters, too: young_modulus, poisson_ratio,"
    " rayleigh_stiffness, rayleigh_mass, ...; of several bodies BODY.young_modulus.",
)

main = partial(run_node, PROGRAM, lambda _: Simulator())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
