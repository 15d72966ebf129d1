"""`softsim test`: run the test suite of the checkout; which tests cover which files.

CONTRIBUTING.md shows the same table; a test compares the two.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import NoReturn

from softsim_core.base import SoftSimError, install_command, listing, python_command, run_process

TESTS: Mapping[str, str] = {
    "softsim_core": "analytic attacks/current_folder unit",
    "softsim_core/physics/actuation": (
        "analytic/actuator* analytic/cable* analytic/chamber* analytic/cut_steps "
        "analytic/falling_balloon analytic/joint* analytic/pump* unit/actuator* unit/cable* "
        "unit/chamber* unit/steppers_agree"
    ),
    "softsim_core/simulation/batch": "batch",
    "softsim_core/physics/contact": (
        "analytic/ball* analytic/contact* analytic/flat* analytic/soft_on_soft analytic/spinning "
        "unit/contact* unit/rigid_bodies unit/steppers_agree"
    ),
    "softsim_core/physics/dynamics": (
        "analytic/beams analytic/consistent_mass analytic/hinge* analytic/iterations analytic/joint* "
        "analytic/motion analytic/rigid_motion analytic/static* analytic/time_integration "
        "reference/held_centre unit/bounded_forces unit/constraint_rows unit/divergence "
        "unit/generalised_forces unit/iterative_steps unit/simulation* unit/snapshot unit/state "
        "unit/step* unit/substeps"
    ),
    "softsim_core/scene/editing": "unit/edit*",
    "softsim_core/physics/fem": (
        "analytic/beams analytic/element* analytic/nodal_stress analytic/prony analytic/quadratic* "
        "analytic/reinforcements analytic/rods* analytic/rubber* analytic/stable* unit/compiled_laws "
        "unit/mass unit/material* unit/nearest_rotation unit/strains"
    ),
    "softsim_core/lab/identification": "identification",
    "softsim_core/control/inverse": (
        "analytic/*inverse* analytic/maze* unit/arm unit/closed_loop* unit/inverse* unit/path* unit/workspace"
    ),
    "softsim_core/physics/kernels": "unit/going_over unit/kernel* unit/steppers_agree",
    "softsim_core/lab/learning": "learning",
    "softsim_core/physics/linalg": (
        "unit/bounded_forces unit/conjugate* unit/divided_trees unit/elimination_order "
        "unit/iterative_steps unit/linear_solvers unit/steppers_agree unit/threads"
    ),
    "softsim_core/physics/mechanics": (
        "analytic/border_stiffness analytic/fixing_boxes analytic/force_torque analytic/hinge* "
        "analytic/joint* analytic/motion analytic/moved_bases analytic/rigid_motion analytic/static* "
        "unit/base_targets unit/constraint_rows unit/limits unit/mass unit/named_command unit/pose "
        "unit/regions unit/transforms unit/velocities"
    ),
    "softsim_core/physics/mesh": (
        "reference/mesh* unit/mesh* unit/points_beside_bodies unit/regions unit/shapes"
    ),
    "softsim_core/lab/meshing": "meshing",
    "softsim_core/mjcf": "mjcf",
    "softsim_core/control/observer": "analytic/observer unit/observer*",
    "softsim_core/robots": (
        "analytic/maze* analytic/pneu* measured/pneumatic* meshing/stl* unit/finger_mesh "
        "unit/gripper_scenes unit/maze_mesh unit/mesh_tripod unit/parts unit/tentacle_mesh"
    ),
    "softsim_core/scene": (
        "unit/animation unit/arm unit/builder unit/foreign_file_names unit/inverse_settings "
        "unit/named_command unit/parts unit/places_of_errors unit/plausibility unit/scene* "
        "unit/trajectory unit/urdf"
    ),
    "softsim_core/physics/sensing": "analytic/force_torque analytic/sensors* unit/sensor*",
    "softsim_core/simulation": (
        "analytic/rest analytic/rods_in_motion reference unit/animation unit/base_targets "
        "unit/divergence unit/going_o* unit/points_beside_bodies unit/simulation* unit/snapshot "
        "unit/start_at_load unit/state unit/substeps"
    ),
    "softsim_core/lab/study": "study",
    "softsim_node": (
        "attacks house/access_policies ros/parameters ros/process_end ros/runtime ros/settable_texts "
        "unit/cli_environment unit/doors unit/ending unit/freed_memory unit/layout unit/moved unit/qos "
        "unit/terminals unit/transforms unit/work_queue"
    ),
    "softsim_ros": (
        "house/launch ros unit/layout unit/messages* unit/moved unit/optional_messages unit/qos "
        "unit/report_pages unit/transforms unit/urdf unit/work_queue"
    ),
    "benchmarks": "benchmarks ros/bridge_benchmark unit/bridge_latency unit/first_start",
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
    "softsim_ros/nodes/inverse": (
        "ros/closed_loop* ros/inverse* ros/path* unit/closed_loop_timing unit/inverse_node_parts "
        "unit/path_player unit/simulated_robot"
    ),
    "softsim_ros/keys": "unit/teleop*",
    "softsim_ros/messages": "ros/sensor_topics ros/simulator_topics ros/state_topics unit/messages*",
    "softsim_ros/nodes/observer": "ros/observer*",
    "softsim_ros/nodes/policy": "ros/policy*",
    "softsim_ros/recording": "recording ros/record*",
    "softsim_ros/nodes/simulator": (
        "ros/follow_joint* ros/live_scene ros/reload* ros/scene* ros/simul* ros/tuning* unit/going_over "
        "unit/led_joints unit/printed_lines unit/simulator* unit/stage* unit/step_stages "
        "unit/trajectory_goal"
    ),
    "softsim_ros/nodes/teleop": "ros/teleop* unit/teleop*",
    "softsim_ros/templates": "identification recording study unit/report_pages",
    "softsim_ros/nodes/viewer": "viewer unit/edit*",
    "servo_bridge": "bridge unit/layout unit/moved",
    "servo_bridge/emulator": "firmware",
    "servo_bridge/firmware": "firmware",
    "configs": "house/launch identification/shipped* measured tutorials unit/parts unit/scene* unit/urdf",
    "configs/dds": "ros/loopback*",
    "examples": "examples house/launch",
    "docs": "docs unit/layout",
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

The longest entry that a path begins with applies.
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
    """Return the words of TESTS that cover a path.

    Raises:
        UncoveredPathError: no entry of TESTS contains the path.
    """
    place = PurePosixPath(path)
    found = next((str(each) for each in (place, *place.parents) if str(each) in TESTS), None)
    if found is None:
        raise UncoveredPathError(path)
    return TESTS[found].split()


def files_of(word: str, root: Path) -> list[str]:
    """Return the files and folders that a word of TESTS names, relative to the checkout."""
    folder, _, name = word.partition("/")
    if not name:
        return [f"tests/{folder}"]
    return sorted(f"tests/{folder}/{file.name}" for file in (root / "tests" / folder).glob(f"test_{name}.py"))


LIMIT_S = {False: 5400, True: 600}
"""Time limits in [s], for hanging tests."""

MOST_WORKERS = 6
"""Largest number of workers; each has its own robot, page and browser, about 1 GB.

A third of the tests' time is waiting for processes, so that one worker more than cores keeps the cores busy.
Quick tests do not wait.
"""

QUICK = "not slow and not exhaustive and not packaging"
"""Tests of `--quick`, as an expression of pytest's option -m."""

_TAKES_A_VALUE = ("-k", "-m", "-p", "-o", "-W", "-c")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="leave the slow tests out")
    parser.add_argument(
        "--workers",
        metavar="N",
        help="test processes (default: one more than cores, with --quick as many; 0: in this one)",
    )
    parser.usage = "softsim test [--quick] [--workers N] [PATH ...] [pytest arguments]"
    parser.epilog = (
        "PATH is a test, or a file or folder of the product, such as softsim_core/physics/contact, whose "
        "tests run. All else goes to pytest: softsim test tests/unit -k codec. Other lanes: -m packaging, "
        "-m exhaustive."
    )


def command(arguments: argparse.Namespace, root: Path) -> list[str]:
    """Return the command line that runs the tests of the checkout at `root`.

    Packaging tests run if a named path contains them; without a path only `-m packaging` runs them.

    Raises:
        UncoveredPathError: no test covers a path.
    """
    words = python_command("pytest", f"--rootdir={root}", "-c", root / "pyproject.toml")
    workers = min((os.cpu_count() or 1) + (not arguments.quick), MOST_WORKERS)
    words += ["-n", arguments.workers or str(workers), "--dist=loadfile"]
    rest, has_paths = _with_tests(arguments.rest, root)
    if arguments.quick:
        words += ["-m", QUICK]
    elif has_paths:
        words += ["-m", "not exhaustive"]
    timeout = shutil.which("timeout")
    limit = [timeout, "--foreground", "-k", "30", str(LIMIT_S[arguments.quick])] if timeout else []
    return [*limit, *words, *rest]


def _with_tests(arguments: Sequence[str], root: Path) -> tuple[list[str], bool]:
    """Return the words with tests in place of paths of the product, and whether any word was a path."""
    words, has_paths, previous, root = list[str](), False, "", root.resolve()
    for word in arguments:
        place = (root / word.partition("::")[0]).resolve()
        is_path = previous not in _TAKES_A_VALUE and root in place.parents and place.exists()
        path = place.relative_to(root).as_posix() if is_path else ""
        words += covering_tests(path, root) if is_path and path.split("/")[0] != "tests" else [word]
        has_paths |= is_path
        previous = word
    return words, has_paths


def run(arguments: argparse.Namespace) -> int:
    """Compile the kernels if needed, then run pytest in place of this process.

    Its exit code is the command's (124: the time limit was reached).
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / "tests").is_dir():
        print(
            f"softsim test: no tests beside the installed package ({root}); use a checkout", file=sys.stderr
        )
        return 1
    if importlib.util.find_spec("pytest") is None or importlib.util.find_spec("xdist") is None:
        print(f"softsim test: pytest or pytest-xdist is missing; {install_command('test')}", file=sys.stderr)
        return 1
    try:
        words = command(arguments, root)
    except UncoveredPathError as error:
        print(f"softsim test: {error}", file=sys.stderr)
        return 2
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile their sources
    run_process(python_command("softsim_core.simulation.warmup"), cwd=root)
    _become(words, root)


def _become(words: list[str], folder: Path) -> NoReturn:
    os.chdir(folder)
    os.execvp(words[0], words)
