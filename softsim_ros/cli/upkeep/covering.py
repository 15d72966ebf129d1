"""Which tests cover which files of the checkout: the table behind `softsim test PATH`.

CONTRIBUTING.md shows the same table; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from softsim_core.errors import SoftSimError, listing

TESTS: Mapping[str, str] = {
    "softsim_core": "analytic attacks/current_folder unit",
    "softsim_core/actuation": (
        "analytic/actuator* analytic/cable* analytic/chamber* analytic/cut_steps "
        "analytic/falling_balloon analytic/joint* analytic/pump* unit/actuator* unit/cable* "
        "unit/chamber* unit/steppers_agree"
    ),
    "softsim_core/batch": "batch",
    "softsim_core/contact": (
        "analytic/ball* analytic/contact* analytic/flat* analytic/soft_on_soft analytic/spinning "
        "unit/contact* unit/rigid_bodies unit/steppers_agree"
    ),
    "softsim_core/dynamics": (
        "analytic/beams analytic/consistent_mass analytic/hinge* analytic/iterations analytic/joint* "
        "analytic/motion analytic/rigid_motion analytic/static* analytic/time_integration "
        "reference/held_centre unit/bounded_forces unit/constraint_rows unit/divergence "
        "unit/generalised_forces unit/iterative_steps unit/simulation* unit/snapshot unit/state "
        "unit/step* unit/substeps"
    ),
    "softsim_core/editing": "unit/edit*",
    "softsim_core/fem": (
        "analytic/beams analytic/element* analytic/nodal_stress analytic/prony analytic/quadratic* "
        "analytic/reinforcements analytic/rods* analytic/rubber* analytic/stable* unit/compiled_laws "
        "unit/mass unit/material* unit/nearest_rotation unit/strains"
    ),
    "softsim_core/identification": "identification",
    "softsim_core/inverse": (
        "analytic/*inverse* analytic/maze* unit/arm unit/closed_loop* unit/inverse* unit/path* unit/workspace"
    ),
    "softsim_core/kernels": "unit/going_over unit/kernel* unit/steppers_agree",
    "softsim_core/learning": "learning",
    "softsim_core/linalg": (
        "unit/bounded_forces unit/conjugate* unit/divided_trees unit/elimination_order "
        "unit/iterative_steps unit/linear_solvers unit/steppers_agree unit/threads"
    ),
    "softsim_core/mechanics": (
        "analytic/border_stiffness analytic/fixing_boxes analytic/force_torque analytic/hinge* "
        "analytic/joint* analytic/motion analytic/moved_bases analytic/rigid_motion analytic/static* "
        "unit/base_targets unit/constraint_rows unit/limits unit/mass unit/named_command unit/pose "
        "unit/regions unit/transforms unit/velocities"
    ),
    "softsim_core/mesh": "reference/mesh* unit/mesh* unit/points_beside_bodies unit/regions unit/shapes",
    "softsim_core/meshing": "meshing",
    "softsim_core/mjcf": "mjcf",
    "softsim_core/observer": "analytic/observer unit/observer*",
    "softsim_core/robots": (
        "analytic/maze* analytic/pneu* measured/pneumatic* meshing/stl* unit/finger_mesh "
        "unit/gripper_scenes unit/maze_mesh unit/mesh_tripod unit/parts unit/tentacle_mesh"
    ),
    "softsim_core/scene": (
        "unit/animation unit/arm unit/builder unit/foreign_file_names unit/inverse_settings "
        "unit/named_command unit/parts unit/places_of_errors unit/plausibility unit/scene* "
        "unit/trajectory unit/urdf"
    ),
    "softsim_core/sensing": "analytic/force_torque analytic/sensors* unit/sensor*",
    "softsim_core/simulation": (
        "analytic/rest analytic/rods_in_motion reference unit/animation unit/base_targets "
        "unit/divergence unit/going_o* unit/points_beside_bodies unit/simulation* unit/snapshot "
        "unit/start_at_load unit/state unit/substeps"
    ),
    "softsim_core/study": "study",
    "softsim_node": (
        "attacks house/access_policies ros/parameters ros/process_end ros/runtime ros/settable_texts "
        "unit/cli_environment unit/doors unit/ending unit/freed_memory unit/terminals unit/transforms"
    ),
    "softsim_ros": (
        "house/launch ros unit/messages* unit/optional_messages unit/qos unit/transforms unit/urdf "
        "unit/work_queue"
    ),
    "softsim_ros/benchmark": "benchmarks unit/bridge_latency unit/first_start",
    "softsim_ros/cli": (
        "house/bad_networks house/launcher house/hosted_ci ros/topics* ros/up unit/cli* unit/extras "
        "unit/web_page"
    ),
    "softsim_ros/cli/board": "bridge/calibration bridge/bridge_protocols firmware/flash*",
    "softsim_ros/cli/demos": "analytic/pick_and_place ros/demo*",
    "softsim_ros/cli/measurements": "identification ros/excite",
    "softsim_ros/cli/recordings": "recording ros/record*",
    "softsim_ros/cli/robots": "meshing mjcf unit/cli* unit/parts unit/urdf unit/workspace",
    "softsim_ros/cli/studies": "study",
    "softsim_ros/cli/upkeep": "benchmarks house/covering unit/cli*",
    "softsim_ros/client": "ros/client unit/teleop*",
    "softsim_ros/description": "house/launch unit/urdf",
    "softsim_ros/excitation": "ros/excite",
    "softsim_ros/inverse": (
        "ros/closed_loop* ros/inverse* ros/path* unit/closed_loop_timing unit/inverse_node_parts "
        "unit/path_player unit/simulated_robot"
    ),
    "softsim_ros/keys": "unit/teleop*",
    "softsim_ros/messages": "ros/sensor_topics ros/simulator_topics ros/state_topics unit/messages*",
    "softsim_ros/observer": "ros/observer*",
    "softsim_ros/policy": "ros/policy*",
    "softsim_ros/recording": "recording ros/record*",
    "softsim_ros/simulator": (
        "ros/follow_joint* ros/live_scene ros/reload* ros/scene* ros/simul* ros/tuning* unit/going_over "
        "unit/led_joints unit/printed_lines unit/simulator* unit/stage* unit/step_stages "
        "unit/trajectory_goal"
    ),
    "softsim_ros/teleop": "ros/teleop* unit/teleop*",
    "softsim_ros/viewer": "viewer unit/edit*",
    "servo_bridge": "bridge",
    "servo_bridge/emulator": "firmware",
    "servo_bridge/firmware": "firmware",
    "configs": "house/launch identification/shipped* measured tutorials unit/parts unit/scene* unit/urdf",
    "configs/dds": "ros/loopback*",
    "examples": "examples house/launch",
    "docs": "docs",
    "docs/tutorials": "docs tutorials",
    "ros2_ws": "house/colcon house/launch house/packaging",
    "build_backend": "house/distribution",
    "softsim": "house/bad_networks house/child_processes house/launcher",
    ".ci": "docs house",
    ".github": "house/hosted_ci",
    ".devcontainer": "house/hosted_ci",
    "Dockerfile": "house/hosted_ci",
    "pyproject.toml": "house/distribution house/packaging",
    "constraints.txt": "house/packaging",
    "requirements.lock": "house/packaging",
    "mkdocs.yml": "docs",
    "CONTRIBUTING.md": "docs house/covering",
    "README.md": "docs house/distribution tutorials",
}
"""Tests by folder or file: `unit` is tests/unit, `unit/mesh*` every tests/unit/test_mesh*.py.

The longest name that a path begins with counts.
"""


class UncoveredPathError(SoftSimError):
    """A path that no test covers.

    Args:
        path: The path, relative to the checkout.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        super().__init__(
            f"no test covers {path}; name a test (tests/...), or a file or folder of "
            f"{listing(name for name in TESTS if '/' not in name)}"
        )


def covering_tests(path: str, root: Path) -> list[str]:
    """Return the test files and folders that cover a path of the checkout.

    Args:
        path: Relative to the checkout, with "/".
        root: The checkout.

    Raises:
        UncoveredPathError: no entry of TESTS contains the path.
    """
    return [file for word in covering_words(path) for file in files_of(word, root)]


def covering_words(path: str) -> list[str]:
    """Return the words of TESTS that stand for the tests of a path.

    Raises:
        UncoveredPathError: no entry of TESTS contains the path.
    """
    place = PurePosixPath(path)
    found = next((str(each) for each in (place, *place.parents) if str(each) in TESTS), None)
    if found is None:
        raise UncoveredPathError(path)
    return TESTS[found].split()


def files_of(word: str, root: Path) -> list[str]:
    """Return what a word of TESTS stands for, relative to the checkout."""
    folder, _, name = word.partition("/")
    if not name:
        return [f"tests/{folder}"]
    return sorted(f"tests/{folder}/{file.name}" for file in (root / "tests" / folder).glob(f"test_{name}.py"))
