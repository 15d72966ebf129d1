"""Parameters of a simulator in another process: ranges, read-only ones, what a change does."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from geometry_msgs.msg import PoseStamped  # noqa: E402
from rcl_interfaces.srv import DescribeParameters  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402


def settled_height(robot: Any, spin_until: Any) -> float:
    """Height of the effector in [m] once it is at rest."""
    poses = robot.client.collect(PoseStamped, "effector_pose")

    def at_rest() -> bool:
        heights = [pose.pose.position.z for pose in poses[-30:]]
        return len(heights) == 30 and max(heights) - min(heights) < 1e-7

    assert spin_until(at_rest)
    return float(poses[-1].pose.position.z)


def test_the_graph_lists_its_services_of_parameters(tripod: Any, spin_until: Any) -> None:
    wanted = {f"/tripod/simulator/{name}_parameters" for name in ("set", "get", "list", "describe")}
    assert spin_until(lambda: wanted <= tripod.client.offered("simulator", "/tripod", services=True).keys())


def test_a_softer_material_sags_more(tripod: Any, spin_until: Any) -> None:
    stiff = settled_height(tripod, spin_until)
    assert tripod.set_parameters(young_modulus=125.0e3) == (True, "")
    soft = settled_height(tripod, spin_until)
    assert 0.03 - soft == pytest.approx(2.0 * (0.03 - stiff), rel=0.1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("young_modulus", -1.0),
        ("young_modulus", 0.0),
        ("poisson_ratio", 0.5),
        ("speed", -1.0),
        ("rayleigh_mass", -0.1),
        ("young_modulus", "soft"),
    ],
)
def test_wrong_values_are_refused_and_change_nothing(tripod: Any, name: str, value: object) -> None:
    before = tripod.get_parameter(name)
    success, sentence = tripod.set_parameters(**{name: value})
    assert not success
    assert name in sentence or "type" in sentence
    assert tripod.get_parameter(name) == before


@pytest.mark.parametrize("bad", [{"poisson_ratio": 0.6}, {"snapshot": "../x"}, {"speed": 1e-9}])
def test_one_bad_value_keeps_all_of_them_out(tripod: Any, bad: dict[str, object]) -> None:
    before = tripod.get_parameter("young_modulus")
    assert not tripod.set_parameters(mesh_rate=7.0, young_modulus=99.0e3, **bad)[0]
    assert tripod.get_parameter("mesh_rate") != 7.0
    assert tripod.get_parameter("young_modulus") == before
    assert tripod.trigger("save")[0]
    assert tripod.trigger("load")[0]  # the parameters tell what the simulation really has
    assert tripod.get_parameter("young_modulus") == before


@pytest.mark.parametrize("name", ["backend", "out_of_range"])
def test_what_is_fixed_at_the_start_is_read_only(tripod: Any, name: str) -> None:
    success, sentence = tripod.set_parameters(**{name: "scipy"})
    assert not success
    assert "read-only" in sentence


def test_every_parameter_has_a_description_and_numbers_have_a_range(tripod: Any) -> None:
    names = [
        "robot",
        "speed",
        "mesh_rate",
        "publish_clock",
        "enforce_limits",
        "young_modulus",
        "snapshot",
    ]
    answer = tripod.client.call(
        DescribeParameters, "simulator/describe_parameters", DescribeParameters.Request(names=names)
    )
    described = {entry.name: entry for entry in answer.descriptors}
    assert all(entry.description for entry in described.values())
    assert described["publish_clock"].read_only
    assert described["young_modulus"].floating_point_range[0].from_value == 1.0


def test_another_scene_runs_on_request_and_an_unknown_one_changes_nothing(
    tripod: Any, spin_until: Any
) -> None:
    success, sentence = tripod.set_parameters(robot="no_such_robot")
    assert not success
    assert "known" in sentence
    assert tripod.get_parameter("robot") == "tripod"
    assert tripod.set_parameters(robot="parts/servo") == (True, "")
    states = tripod.client.collect(JointState, "joint_states")
    assert spin_until(lambda: states and len(states[-1].name) == 1)
    assert tripod.set_parameters(robot="tripod") == (True, "")
    assert spin_until(lambda: len(states[-1].name) == 3)
