"""The services of simulation_interfaces, asked as tools ask any simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from interface_packages import interface_package  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from waiting import spin_until  # noqa: E402

DT = 0.01


@pytest.fixture(scope="module")
def simulation_interfaces(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The package simulation_interfaces, here and in the processes of these tests."""
    with interface_package("simulation_interfaces", tmp_path_factory.mktemp("interfaces")):
        yield


@pytest.fixture(scope="module")
def running_tripod(simulation_interfaces: None, start_robot: Callable[..., Any]) -> Any:
    """A Tripod beside a ball, started with the package."""
    return start_robot(robot="tripod_ball", publish_clock=True)


class Simulator:
    """The standard services of one simulator."""

    def __init__(self, robot: Any) -> None:
        from simulation_interfaces import msg, srv

        self.msg, self._srv, self._client = msg, srv, robot.client
        self._states = robot.client.collect(JointState, "joint_states")

    def ask(self, name: str, **fields: Any) -> Any:
        """The answer of a service, such as "StepSimulation"."""
        kind, service = self._kind(name)
        return self._client.call(kind, service, kind.Request(**fields))

    def begin(self, name: str, **fields: Any) -> Any:
        """Ask and do not wait."""
        kind, service = self._kind(name)
        return self._client.ask_service(kind, service, kind.Request(**fields))

    def result(self, name: str, **fields: Any) -> tuple[int, str]:
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
        """Simulated time in [s], from now on."""
        self._states.clear()
        assert spin_until(lambda: len(self._states) > 1)
        stamp = self._states[-1].header.stamp
        return float(stamp.sec) + 1e-9 * float(stamp.nanosec)

    def _kind(self, name: str) -> tuple[Any, str]:
        words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name)
        return getattr(self._srv, name), f"simulator/{words.lstrip('_')}"


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
        known.STEP_SIMULATION_SINGLE,
        known.STEP_SIMULATION_MULTIPLE,
        known.SIMULATION_STATE_GETTING,
        known.SIMULATION_STATE_SETTING,
        known.SIMULATION_STATE_PAUSE,
        known.ENTITY_STATE_GETTING,
        known.ENTITY_STATE_SETTING,
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
    ("scope", "resets"), [(0, True), (255, True), (3, True), (1, False), (2, False), (4, False)]
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
