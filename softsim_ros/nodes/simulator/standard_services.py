"""Services of simulation_interfaces, where that package is installed; tools use them with any simulator."""

from __future__ import annotations

import math
import re
from collections.abc import Awaitable, Callable
from typing import Any, Final

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.callback_groups import ReentrantCallbackGroup

from softsim_core.base import MOST_NAMES, CommandError, SoftSimError, names_up_to
from softsim_core.simulation import Simulation, check_values, rotation_from
from softsim_node import WORLD, BackgroundWorker, GuardedNode, ending, error_message, one_line
from softsim_ros import messages, optional_module, optional_type
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread
from softsim_ros.nodes.simulator.spawning import RequestError, Spawner

FEATURES: Final = {
    "GetSimulatorFeatures": (),
    "ResetSimulation": ("SIMULATION_RESET", "SIMULATION_RESET_SPAWNED"),
    "StepSimulation": ("STEP_SIMULATION_SINGLE", "STEP_SIMULATION_MULTIPLE"),
    "GetSimulationState": ("SIMULATION_STATE_GETTING",),
    "SetSimulationState": ("SIMULATION_STATE_SETTING", "SIMULATION_STATE_PAUSE"),
    "GetEntities": (),
    "GetEntityState": ("ENTITY_STATE_GETTING",),
    "SetEntityState": ("ENTITY_STATE_SETTING",),
    "GetSpawnables": ("SPAWNABLES",),
    "SpawnEntity": ("SPAWNING",),
    "DeleteEntity": ("DELETING",),
}
"""The services, each with the features that it provides."""

MOST_STEPS: Final = 10_000
"""Largest number of steps per request; while they run, other requests are served more slowly."""

LONGEST_FILTER: Final = 200
MOST_REPEATS: Final = 3
"""Largest number of repetitions in a filter; groups are not allowed.

The time of a match grows with a power given by the number of repetitions.
"""

Handler = Callable[[Any, Any], Awaitable[None]]


class StandardServices:
    """Offers the standard services of one simulation; its entities are the rigid bodies with mass, by name.

    Args:
        node: Owner of the services, which are named after their types: `~/reset_simulation`, ...
        stamp: Returns the time stamp of a state; called in the physics thread.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        stamp: Callable[[Simulation], Time],
        spawner: Spawner,
    ) -> None:
        self._node, self._physics, self._stamp, self._spawner = node, physics, stamp, spawner
        self._background = BackgroundWorker("steps are being done")
        self._stopped = False
        self._messages = optional_module("simulation_interfaces.msg")
        self._offered: list[str] = []
        group = ReentrantCallbackGroup()
        for name in FEATURES:
            kind = optional_type("simulation_interfaces.srv", name)
            if kind is not None:
                service = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
                answer = self._answering(kind, getattr(self, f"_{service}"))
                node.create_service(kind, f"~/{service}", answer, callback_group=group)
                self._offered.append(name)

    def close(self) -> None:
        """Wait for steps in progress."""
        self._background.close()

    def _answering(self, kind: Any, handler: Handler) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return a callback that runs a handler on request and response and sets the result."""
        assert self._messages is not None
        results = self._messages.Result

        async def answer(request: Any, response: Any) -> Any:
            code, message = results.RESULT_OK, ""
            try:
                await handler(request, response)
            except RequestError as refusal:
                own = getattr(kind.Response, refusal.kind, None)
                code = getattr(results, f"RESULT_{refusal.kind}") if own is None else own
                message = str(refusal)
            except Exception as error:
                code, message = results.RESULT_OPERATION_FAILED, error_message(error)
            if message:
                self._node.refuse(message)
            if hasattr(response, "result"):
                response.result.result = code
                response.result.error_message = one_line(message or response.result.error_message)
            return response

        return answer

    async def _get_simulator_features(self, _: Any, response: Any) -> None:
        codes = type(response.features)
        names = [name for offered in self._offered for name in FEATURES[offered]]
        response.features.features = [getattr(codes, name) for name in names if hasattr(codes, name)]
        response.features.custom_info = "scenes are loaded by their names with the parameter robot"

    # --- time -----------------------------------------------------------------------------------------

    async def _reset_simulation(self, request: Any, _: Any) -> None:
        scope = request.scope or request.SCOPE_ALL
        both = request.SCOPE_TIME | request.SCOPE_STATE
        if scope & both not in (0, both):
            raise RequestError("FEATURE_UNSUPPORTED", "time and state are reset together; ask for SCOPE_ALL")
        if scope & request.SCOPE_SPAWNED:
            await self._spawner.clear()
        if scope & both:
            self._physics.reset()

    async def _step_simulation(self, request: Any, _: Any) -> None:
        if request.steps > MOST_STEPS:
            raise RequestError(
                "OPERATION_FAILED", f"{request.steps} steps refused; allowed are {MOST_STEPS} at once"
            )
        if not self._physics.status.paused:
            raise RequestError("INCORRECT_STATE", "the simulation is running; pause it first")
        done = 0

        def step() -> None:
            nonlocal done
            while done < request.steps and not ending.asked:
                self._physics.step_once()
                done += 1

        try:
            await self._background.run(step)
        except SoftSimError as error:
            raise RequestError(
                "OPERATION_FAILED", f"{done} of {request.steps} steps done: {error}"
            ) from error

    async def _get_simulation_state(self, _: Any, response: Any) -> None:
        response.state.state = self._state()

    async def _set_simulation_state(self, request: Any, _: Any) -> None:
        assert self._messages is not None
        states, requested_state = self._messages.SimulationState, request.state.state
        if requested_state not in (states.STATE_STOPPED, states.STATE_PLAYING, states.STATE_PAUSED):
            allowed = "STATE_STOPPED, STATE_PLAYING, STATE_PAUSED"
            raise RequestError(
                "FEATURE_UNSUPPORTED", f"state {requested_state} cannot be asked for; allowed are {allowed}"
            )
        if requested_state == self._state():
            raise RequestError("ALREADY_IN_TARGET_STATE", "the simulation is in this state")
        self._physics.pause(requested_state != states.STATE_PLAYING)
        self._stopped = requested_state == states.STATE_STOPPED
        if self._stopped:
            self._physics.reset()

    def _state(self) -> int:
        assert self._messages is not None
        states, status = self._messages.SimulationState, self._physics.status
        if not status.paused:
            return int(states.STATE_PLAYING)
        return int(states.STATE_STOPPED if self._stopped and not status.steps else states.STATE_PAUSED)

    # --- entities -------------------------------------------------------------------------------------

    async def _get_entities(self, request: Any, response: Any) -> None:
        filters = request.filters
        if len(filters.categories) or filters.tags.tags or filters.bounds.points:
            raise RequestError(
                "FEATURE_UNSUPPORTED", "entities have no categories, tags or bounds; filter by name"
            )
        pattern = _pattern(filters.filter)
        names = self._physics.call(lambda simulation: simulation.rigid_names, shows=False)
        response.entities = [name for name in names if pattern.search(name)]

    async def _get_entity_state(self, request: Any, response: Any) -> None:
        def read(simulation: Simulation) -> Any:
            number = _number(simulation, request.entity)
            state = response.state
            state.header = messages.header(self._stamp(simulation), WORLD)
            free = {
                body.free: pose
                for body, pose in zip(simulation.rigid_bodies, simulation.rigid_poses, strict=True)
            }
            state.pose = messages.pose(free[number].position, free[number].quaternion_xyzw)
            velocities = simulation.rigid_velocities[number].tolist()
            for vector, values in (
                (state.twist.linear, velocities[:3]),
                (state.twist.angular, velocities[3:]),
                (state.acceleration.linear, [math.nan] * 3),  # is not measured
                (state.acceleration.angular, [math.nan] * 3),
            ):
                vector.x, vector.y, vector.z = values

        self._physics.call(read, shows=False)

    async def _set_entity_state(self, request: Any, _: Any) -> None:
        state, frame = request.state, request.state.header.frame_id
        if frame not in ("", WORLD):
            raise RequestError(
                "OPERATION_FAILED", f"frame {names_up_to(1, [frame])} refused; give the state in {WORLD}"
            )
        place, turn = state.pose.position, state.pose.orientation
        linear, angular = state.twist.linear, state.twist.angular
        values = np.array(
            [place.x, place.y, place.z, linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        )
        if not np.isfinite(values).all():
            raise CommandError("state refused: expected finite numbers; nothing was changed")

        def write(simulation: Simulation) -> None:
            _number(simulation, request.entity)
            simulation.place_rigid_body(request.entity, values[:3], (turn.x, turn.y, turn.z, turn.w))
            simulation.set_body_velocity(request.entity, values[3:6], values[6:])

        self._physics.call(write)

    # --- spawning and deleting ------------------------------------------------------------------------

    async def _get_spawnables(self, request: Any, response: Any) -> None:
        assert self._messages is not None
        for uri, body in (await self._spawner.list_known()).items():
            entry = self._messages.Spawnable(description=f"rigid body of {1e3 * (body.mass or 0.0):g} g")
            _resource(entry).uri = uri
            response.spawnables.append(entry)
        if request.sources:
            names = names_up_to(MOST_NAMES, request.sources)
            response.result.error_message = f"unknown sources {names} were left out"

    async def _spawn_entity(self, request: Any, response: Any) -> None:
        resource, pose = _resource(request), request.initial_pose.pose
        if request.entity_namespace:
            raise RequestError(
                "NAMESPACE_INVALID", "entities have no interfaces of their own; leave entity_namespace empty"
            )
        if not resource.uri:
            kind = "UNSUPPORTED_FORMAT" if resource.resource_string else "NO_RESOURCE"
            raise RequestError(kind, "only a uri that get_spawnables lists can be spawned; give one")
        place, turn = pose.position, pose.orientation
        frame = request.initial_pose.header.frame_id
        if frame not in ("", WORLD):
            raise RequestError(
                "INVALID_POSE", f"frame {names_up_to(1, [frame])} refused; give the pose in {WORLD}"
            )
        try:
            position = check_values("position", (place.x, place.y, place.z), (3,), "m")
            rotation = rotation_from((turn.x, turn.y, turn.z, turn.w))
        except CommandError as error:
            raise RequestError("INVALID_POSE", str(error)) from error
        response.entity_name = await self._spawner.spawn(
            resource.uri, request.name, request.allow_renaming, position, rotation
        )

    async def _delete_entity(self, request: Any, _: Any) -> None:
        await self._spawner.delete(request.entity)


def _resource(message: Any) -> Any:
    """Return the object with `uri` and `resource_string`: the message, or its field since release 2."""
    return getattr(message, "entity_resource", message)


def _number(simulation: Simulation, name: str) -> int:
    """Return the number of an entity among the rigid bodies."""
    if name not in simulation.rigid_names:
        entities = names_up_to(MOST_NAMES, simulation.rigid_names)
        raise RequestError("NOT_FOUND", f"no entity {names_up_to(1, [name])}; there are: {entities}")
    return simulation.rigid_names.index(name)


def _pattern(text: str) -> re.Pattern[str]:
    """Compile a filter that is sure to match in a short time."""
    repeats = sum(text.count(mark) for mark in "*+?")
    if len(text) > LONGEST_FILTER or repeats > MOST_REPEATS or set(text) & set("(){}\\"):
        raise CommandError(
            f"filter refused: allowed are {LONGEST_FILTER} characters, {MOST_REPEATS} of *, + and ?, and no "
            "groups, braces or backslashes"
        )
    try:
        return re.compile(text)
    except re.error as error:
        raise CommandError(f"filter refused: {error}") from error
