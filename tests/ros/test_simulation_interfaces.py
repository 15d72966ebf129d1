"""The services of simulation_interfaces, asked as tools ask any simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from geometry_msgs.msg import PoseStamped  # noqa: E402
from interface_packages import interface_package  # noqa: E402
from waiting import spin_until  # noqa: E402

DT = 0.01
MINE = """
name: mine
rigid_bodies:
  - {name: brick, shape: {box: [0.02, 0.02, 0.01]}, mass: 0.012, velocity: [9.0, 0.0, 0.0]}
  - {name: wall, shape: {box: [1.0, 1.0, 0.01]}}
"""
CODE = """
open({mark!r}, "w").write("ran")
def create_scene(scene):
    scene.rigid_body("thing", sphere=0.01, mass=0.1)
"""


@pytest.fixture(scope="module")
def simulation_interfaces() -> Iterator[None]:
    """The package simulation_interfaces, here and in the processes of these tests."""
    with interface_package("simulation_interfaces"):
        yield


@pytest.fixture(scope="module")
def running_tripod(
    simulation_interfaces: None, start_robot: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Any:
    """A Tripod beside a ball, started with the package and a folder of further scenes, one of them code."""
    folder = tmp_path_factory.mktemp("configs")
    (folder / "scenes").mkdir()
    (folder / "scenes" / "mine.yaml").write_text(MINE)
    (folder / "scenes" / "code.py").write_text(CODE.format(mark=str(folder / "mark")))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOFTSIM_CONFIG_PATH", str(folder))
        return start_robot(robot="tripod_ball", publish_clock=True)


class Simulator:
    """The standard services of one simulator."""

    def __init__(self, robot: Any) -> None:
        from simulation_interfaces import msg, srv

        self.msg, self.srv, self._client = msg, srv, robot.client

    def ask(self, name: str, /, **fields: Any) -> Any:
        """The answer of a service, such as "StepSimulation"."""
        kind, service = self._kind(name)
        return self._client.call(kind, service, kind.Request(**fields))

    def begin(self, name: str, /, **fields: Any) -> Any:
        """Ask and do not wait."""
        kind, service = self._kind(name)
        return self._client.ask_service(kind, service, kind.Request(**fields))

    def result(self, name: str, /, **fields: Any) -> tuple[int, str]:
        """Code and sentence of an answer."""
        answer = self.ask(name, **fields)
        return answer.result.result, answer.result.error_message

    def set_state(self, state: int) -> int:
        return int(self.result("SetSimulationState", state=self.msg.SimulationState(state=state))[0])

    @property
    def state(self) -> int:
        answer = self.ask("GetSimulationState")
        assert answer.result.result == self.msg.Result.RESULT_OK
        return int(answer.state.state)

    @property
    def time(self) -> float:
        """Simulated time in [s], as the physics thread stamps its answer; topics would tell older steps."""
        stamp = self.ask("GetEntityState", entity="ball").state.header.stamp
        return float(stamp.sec) + 1e-9 * float(stamp.nanosec)

    def _kind(self, name: str) -> tuple[Any, str]:
        words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name)
        return getattr(self.srv, name), f"simulator/{words.lstrip('_')}"


@pytest.fixture
def simulator(running_tripod: Any) -> Simulator:
    """Running, at its start."""
    made = Simulator(running_tripod)
    assert running_tripod.pause(False)[0]
    assert running_tripod.trigger("reset")[0]
    return made


def test_the_features_are_those_that_are_there(simulator: Simulator) -> None:
    known = simulator.msg.SimulatorFeatures
    assert list(simulator.ask("GetSimulatorFeatures").features.features) == [
        known.SIMULATION_RESET,
        known.SIMULATION_RESET_SPAWNED,
        known.STEP_SIMULATION_SINGLE,
        known.STEP_SIMULATION_MULTIPLE,
        known.SIMULATION_STATE_GETTING,
        known.SIMULATION_STATE_SETTING,
        known.SIMULATION_STATE_PAUSE,
        known.ENTITY_STATE_GETTING,
        known.ENTITY_STATE_SETTING,
        known.SPAWNABLES,
        known.SPAWNING,
        known.DELETING,
    ]


def test_it_plays_pauses_and_stops(simulator: Simulator, running_tripod: Any) -> None:
    states, ok = simulator.msg.SimulationState, simulator.msg.Result.RESULT_OK
    already = 101  # SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert simulator.state == states.STATE_PLAYING
    assert simulator.set_state(states.STATE_PLAYING) == already
    assert spin_until(lambda: simulator.time > 10 * DT)
    assert simulator.set_state(states.STATE_PAUSED) == ok
    assert simulator.state == states.STATE_PAUSED
    assert simulator.set_state(states.STATE_PAUSED) == already
    stood = simulator.time
    assert stood > 10 * DT
    assert simulator.time == stood
    assert simulator.set_state(states.STATE_STOPPED) == ok
    assert (simulator.state, simulator.time) == (states.STATE_STOPPED, 0.0)
    assert simulator.set_state(states.STATE_PAUSED) == ok  # as another start, paused
    assert (simulator.state, simulator.time) == (states.STATE_PAUSED, 0.0)
    assert simulator.set_state(states.STATE_PLAYING) == ok
    assert spin_until(lambda: simulator.time > 0.0)
    assert simulator.set_state(states.STATE_QUITTING) == simulator.msg.Result.RESULT_FEATURE_UNSUPPORTED
    assert running_tripod.process.process.poll() is None


def test_steps_are_done_while_it_is_paused_and_counted(simulator: Simulator, running_tripod: Any) -> None:
    results = simulator.msg.Result
    assert simulator.result("StepSimulation", steps=1) == (
        results.RESULT_INCORRECT_STATE,
        "the simulation is running; pause it first",
    )
    simulator.set_state(simulator.msg.SimulationState.STATE_STOPPED)
    for steps in (1, 0, 7):
        assert simulator.result("StepSimulation", steps=steps) == (results.RESULT_OK, "")
    assert simulator.time == pytest.approx(8 * DT)
    code, sentence = simulator.result("StepSimulation", steps=2**64 - 1)
    assert code == results.RESULT_OPERATION_FAILED
    assert "allowed are 10000 at once" in sentence
    assert simulator.time == pytest.approx(8 * DT)


def test_long_stepping_lets_others_in_and_ends_when_it_is_told_to_play(simulator: Simulator) -> None:
    simulator.set_state(simulator.msg.SimulationState.STATE_STOPPED)
    stepping = simulator.begin("StepSimulation", steps=10_000)
    assert spin_until(lambda: simulator.time > 3 * DT)
    assert not stepping.done()
    simulator.set_state(simulator.msg.SimulationState.STATE_PLAYING)
    assert spin_until(stepping.done)
    answer = stepping.result().result
    assert answer.result == simulator.msg.Result.RESULT_OPERATION_FAILED
    assert "of 10000 steps done: step refused: the simulation is running" in answer.error_message


@pytest.mark.parametrize(
    ("scope", "resets"), [(0, True), (255, True), (3, True), (1, False), (2, False), (5, False)]
)
def test_time_and_state_are_reset_together(simulator: Simulator, scope: int, resets: bool) -> None:
    states, results = simulator.msg.SimulationState, simulator.msg.Result
    simulator.set_state(states.STATE_PAUSED)
    simulator.result("StepSimulation", steps=5)
    before = simulator.time
    code, sentence = simulator.result("ResetSimulation", scope=scope)
    if resets:
        assert (code, simulator.time) == (results.RESULT_OK, 0.0)
    else:
        assert (code, simulator.time) == (results.RESULT_FEATURE_UNSUPPORTED, before)
        assert sentence == "time and state are reset together; ask for SCOPE_ALL"
    assert simulator.state == states.STATE_PAUSED


@pytest.mark.parametrize(
    ("filters", "found"),
    [("", ["ball"]), ("ball", ["ball"]), ("^b.*l$", ["ball"]), ("cube|all", ["ball"]), ("cube", [])],
)
def test_entities_are_found_by_their_names(simulator: Simulator, filters: str, found: list[str]) -> None:
    answer = simulator.ask("GetEntities", filters=simulator.msg.EntityFilters(filter=filters))
    assert (answer.result.result, list(answer.entities)) == (simulator.msg.Result.RESULT_OK, found)


@pytest.mark.parametrize(
    ("filters", "sentence"),
    [
        ("(b+)+$", "filter refused: allowed are"),
        (".*.*.*.*x", "filter refused: allowed are"),
        ("b" * 201, "filter refused: allowed are"),
        ("[", "filter refused: unterminated character set"),
    ],
)
def test_filters_that_take_long_or_mean_nothing_are_refused(
    simulator: Simulator, filters: str, sentence: str
) -> None:
    code, said = simulator.result("GetEntities", filters=simulator.msg.EntityFilters(filter=filters))
    assert code == simulator.msg.Result.RESULT_OPERATION_FAILED
    assert said.startswith(sentence)


def test_filters_that_nothing_has_are_not_supported(simulator: Simulator) -> None:
    tags = simulator.msg.TagsFilter(tags=["red"])
    code, sentence = simulator.result("GetEntities", filters=simulator.msg.EntityFilters(tags=tags))
    assert code == simulator.msg.Result.RESULT_FEATURE_UNSUPPORTED
    assert sentence.endswith("filter by name")


def test_an_entity_is_put_somewhere_and_goes_on_from_there(simulator: Simulator) -> None:
    states, ok = simulator.msg.SimulationState, simulator.msg.Result.RESULT_OK
    simulator.set_state(states.STATE_PAUSED)
    state = simulator.ask("GetEntityState", entity="ball").state
    assert state.header.frame_id == "world"
    assert math.isnan(state.acceleration.linear.z)
    state.pose.position.x, state.pose.position.z = 0.3, 2.0
    state.pose.orientation.w, state.pose.orientation.y = 0.8, 0.6
    state.twist.linear.x, state.twist.linear.z, state.twist.angular.z = 0.5, 0.0, 3.0
    assert simulator.result("SetEntityState", entity="ball", state=state) == (ok, "")
    put = simulator.ask("GetEntityState", entity="ball").state
    assert put.pose.position == state.pose.position
    assert (put.pose.orientation.w, put.pose.orientation.y) == (pytest.approx(0.8), pytest.approx(0.6))
    assert (put.twist.linear.x, put.twist.angular.z) == (0.5, 3.0)
    simulator.result("StepSimulation", steps=10)
    flown = simulator.ask("GetEntityState", entity="ball").state
    assert flown.pose.position.x - 0.3 == pytest.approx(0.5 * 10 * DT, rel=0.05)
    assert flown.twist.linear.z == pytest.approx(-9.81 * 10 * DT, rel=0.05)


def test_states_that_cannot_be_are_refused_and_change_nothing(simulator: Simulator) -> None:
    results = simulator.msg.Result
    simulator.set_state(simulator.msg.SimulationState.STATE_PAUSED)
    before = simulator.ask("GetEntityState", entity="ball").state

    def refused(code: int, sentence: str, entity: str = "ball") -> None:
        answer = simulator.result("SetEntityState", entity=entity, state=state)
        assert answer[0] == code
        assert sentence in answer[1]
        now = simulator.ask("GetEntityState", entity="ball").state
        assert (now.pose, now.twist) == (before.pose, before.twist)

    state = simulator.ask("GetEntityState", entity="ball").state
    refused(results.RESULT_NOT_FOUND, "no entity cube; there are: ball", entity="cube")
    state.header.frame_id = "tripod/effector"
    refused(results.RESULT_OPERATION_FAILED, "frame tripod/effector refused; give the state in world")
    state.header.frame_id = ""
    state.pose.orientation.w = 2.0
    refused(results.RESULT_OPERATION_FAILED, "quaternion of length")
    state.pose.orientation = before.pose.orientation
    state.twist.linear.y = math.nan
    refused(results.RESULT_OPERATION_FAILED, "expected finite numbers")
    assert simulator.result("GetEntityState", entity="x" * 10**5)[0] == results.RESULT_NOT_FOUND


class Spawns:
    """Spawning and deleting on a simulator."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator

    def spawn(self, uri: str, z: float = 1.0, **fields: Any) -> Any:
        """The answer to a spawn above the robot."""
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.z = 0.4, z
        return self.simulator.ask("SpawnEntity", **{"uri": uri, "initial_pose": pose, **fields})

    @property
    def entities(self) -> list[str]:
        return list(self.simulator.ask("GetEntities").entities)

    def state(self, entity: str) -> Any:
        return self.simulator.ask("GetEntityState", entity=entity).state


@pytest.fixture
def spawns(simulator: Simulator) -> Iterator[Spawns]:
    """Nothing of one test is there in the next."""
    yield Spawns(simulator)
    simulator.ask("ResetSimulation", scope=simulator.srv.ResetSimulation.Request.SCOPE_SPAWNED)


def test_what_can_be_spawned_are_bodies_of_known_scenes(
    simulator: Simulator, spawns: Spawns, tmp_path_factory: pytest.TempPathFactory
) -> None:
    answer = simulator.ask("GetSpawnables", sources=["https://example.org"])
    uris = [each.uri for each in answer.spawnables]
    assert {"objects/ball", "objects/cube", "objects/can", "tripod_ball/ball", "mine/brick"} <= {*uris}
    assert not any("table" in uri or "wall" in uri or "code" in uri for uri in uris)
    assert answer.result.result == simulator.msg.Result.RESULT_OK
    assert answer.result.error_message == "unknown sources https://example.org were left out"
    assert [each.name for each in tmp_path_factory.getbasetemp().glob("configs*/mark")] == []


def test_an_entity_comes_falls_and_goes_and_the_others_go_on(spawns: Spawns, simulator: Simulator) -> None:
    simulator.set_state(simulator.msg.SimulationState.STATE_PAUSED)
    simulator.result("StepSimulation", steps=30)
    before, ball = simulator.time, spawns.state("ball")
    pose = PoseStamped()
    pose.header.frame_id = "world"
    pose.pose.position.x, pose.pose.position.z = 0.4, 2.0
    pose.pose.orientation.w, pose.pose.orientation.y = 0.8, 0.6
    answer = spawns.spawn("mine/brick", name="red_brick", initial_pose=pose)
    assert (answer.result.result, answer.entity_name) == (simulator.msg.Result.RESULT_OK, "red_brick")
    assert spawns.entities == ["ball", "red_brick"]
    assert simulator.time == before
    assert spawns.state("ball").pose == ball.pose
    assert spawns.state("ball").twist == ball.twist
    put = spawns.state("red_brick")
    assert (put.pose.position.x, put.pose.position.z) == (pytest.approx(0.4), pytest.approx(2.0))
    assert (put.pose.orientation.w, put.pose.orientation.y) == (pytest.approx(0.8), pytest.approx(0.6))
    assert (put.twist.linear.x, put.twist.linear.z) == (0.0, 0.0)
    simulator.result("StepSimulation", steps=10)
    assert spawns.state("red_brick").twist.linear.z == pytest.approx(-9.81 * 10 * DT, rel=1e-6)
    moved = spawns.state("ball")
    assert simulator.result("DeleteEntity", entity="red_brick") == (simulator.msg.Result.RESULT_OK, "")
    assert spawns.entities == ["ball"]
    assert spawns.state("ball").pose == moved.pose
    assert simulator.time == pytest.approx(before + 10 * DT)


def test_a_spawned_thing_lies_on_what_the_scene_has(spawns: Spawns, simulator: Simulator) -> None:
    """The table of the scene ends 24 mm under the origin."""
    simulator.set_state(simulator.msg.SimulationState.STATE_PAUSED)
    pose = PoseStamped()
    pose.pose.position.x, pose.pose.position.z = 0.15, -0.013
    assert spawns.spawn("objects/cube", initial_pose=pose).entity_name == "cube"
    simulator.result("StepSimulation", steps=60)
    lying = spawns.state("cube")
    assert lying.pose.position.z == pytest.approx(-0.014, abs=2e-3)
    assert abs(lying.twist.linear.z) < 1e-3
    simulator.result("DeleteEntity", entity="cube")


def test_names_are_made_where_it_is_allowed(spawns: Spawns, simulator: Simulator) -> None:
    kind = simulator.srv.SpawnEntity.Response
    taken = spawns.spawn("objects/ball")
    assert (taken.result.result, taken.result.error_message) == (
        kind.NAME_NOT_UNIQUE,
        "the name ball is taken; choose another one",
    )
    assert spawns.spawn("objects/ball", allow_renaming=True).entity_name == "ball_1"
    assert spawns.spawn("objects/ball", 1.5, allow_renaming=True).entity_name == "ball_2"
    assert spawns.entities == ["ball", "ball_1", "ball_2"]
    before = simulator.time
    scope = simulator.srv.ResetSimulation.Request.SCOPE_SPAWNED
    assert simulator.result("ResetSimulation", scope=scope)[0] == simulator.msg.Result.RESULT_OK
    assert spawns.entities == ["ball"]
    assert spin_until(lambda: simulator.time > before)


@pytest.mark.parametrize("scope", [0, 255])
def test_a_whole_reset_takes_the_spawned_away(spawns: Spawns, simulator: Simulator, scope: int) -> None:
    assert spawns.spawn("objects/can").entity_name == "can"
    simulator.set_state(simulator.msg.SimulationState.STATE_PAUSED)
    assert simulator.result("ResetSimulation", scope=scope)[0] == simulator.msg.Result.RESULT_OK
    assert (spawns.entities, simulator.time) == (["ball"], 0.0)


def test_spawned_things_stay_when_the_scene_is_loaded_anew(
    spawns: Spawns, simulator: Simulator, running_tripod: Any
) -> None:
    assert spawns.spawn("objects/can").entity_name == "can"
    assert running_tripod.trigger("reload")[0]
    assert spawns.entities == ["ball", "can"]
    assert simulator.result("DeleteEntity", entity="can")[0] == simulator.msg.Result.RESULT_OK


@pytest.mark.parametrize(
    ("fields", "kind", "sentence"),
    [
        ({"uri": ""}, "NO_RESOURCE", "only a uri that get_spawnables lists"),
        ({"uri": "", "resource_string": "<sdf/>"}, "UNSUPPORTED_FORMAT", "only a uri"),
        ({"uri": "objects/anvil"}, "RESULT_NOT_FOUND", "nothing to spawn is called objects/anvil"),
        ({"uri": "objects/table"}, "RESULT_NOT_FOUND", "nothing to spawn is called objects/table"),
        ({"uri": "code/thing"}, "RESULT_NOT_FOUND", "nothing to spawn is called code/thing"),
        ({"uri": "../mine/brick"}, "RESULT_NOT_FOUND", "nothing to spawn is called ../mine/brick"),
        ({"uri": "x" * 10**5}, "RESULT_NOT_FOUND", "nothing to spawn is called xxx"),
        ({"name": "a/b"}, "NAME_INVALID", "name a/b refused; allowed are at most 63 letters"),
        ({"entity_namespace": "left"}, "NAMESPACE_INVALID", "leave entity_namespace empty"),
        ({"frame": "tripod/effector"}, "INVALID_POSE", "give the pose in world"),
        ({"turn": 2.0}, "INVALID_POSE", "quaternion of length 2 refused"),
        ({"height": math.nan}, "INVALID_POSE", "expected numbers in m"),
        ({"height": 0.05}, "INVALID_POSE", "overlap"),
    ],
)
def test_spawns_that_cannot_be_are_refused_and_change_nothing(
    spawns: Spawns, simulator: Simulator, fields: dict[str, Any], kind: str, sentence: str
) -> None:
    pose = PoseStamped()
    pose.pose.position.z = fields.pop("height", 1.0)
    pose.pose.orientation.w = fields.pop("turn", 1.0)
    pose.header.frame_id = fields.pop("frame", "")
    asked = {"uri": "mine/brick", "name": "brick", "initial_pose": pose, **fields}
    answer = simulator.ask("SpawnEntity", **asked)
    codes = simulator.msg.Result if kind.startswith("RESULT") else simulator.srv.SpawnEntity.Response
    assert answer.result.result == getattr(codes, kind)
    assert sentence in answer.result.error_message
    assert len(answer.result.error_message) <= 300
    assert (answer.entity_name, spawns.entities) == ("", ["ball"])


@pytest.mark.parametrize(
    ("entity", "kind", "sentence"),
    [
        ("ball", "RESULT_OPERATION_FAILED", "ball belongs to the scene tripod; only spawned ones go"),
        ("silicone", "RESULT_OPERATION_FAILED", "silicone belongs to the scene"),
        ("anvil", "RESULT_NOT_FOUND", "no entity anvil; spawned are: none"),
    ],
)
def test_what_was_not_spawned_is_not_deleted(
    simulator: Simulator, entity: str, kind: str, sentence: str
) -> None:
    code, said = simulator.result("DeleteEntity", entity=entity)
    assert code == getattr(simulator.msg.Result, kind)
    assert said.startswith(sentence)
