"""The shipped policies of SROS 2 against what the nodes really declare, and against what sros2 reads."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

from access_policies import FOLDER, RULES, VERSION, read_policies, settled_rights, write_policies
from node_processes import private_ros

from servo_bridge.emulator import why_missing
from softsim_node import process
from softsim_ros.cli.running import NODES

REPOSITORY = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.ros


@pytest.mark.slow
def test_the_policies_allow_what_the_nodes_declare_and_nothing_else() -> None:
    shipped = read_policies(FOLDER)
    if missing := why_missing():  # the board is emulated elsewhere
        assert "REQUIRE_SIMAVR" not in os.environ, missing
        shipped = {right for right in shipped if right.executable != "emulated_board"}
    if find_spec("onnxruntime") is None:  # what runs policies is an extra
        shipped = {right for right in shipped if right.executable != "policy"}
    declared = settled_rights(shipped, emulated=not missing)
    anew = "write them anew: PYTHONPATH=. python tests/access_policies.py"
    assert sorted(declared - shipped) == [], f"not allowed; {anew}"
    assert sorted(shipped - declared) == [], f"allowed, and nobody needs it; {anew}"


def test_every_executable_has_a_policy_in_the_form_that_sros2_reads(tmp_path: Path) -> None:
    assert {file.stem for file in FOLDER.glob("*.xml")} == {*NODES}
    for file in FOLDER.glob("*.xml"):
        root = ElementTree.parse(file).getroot()
        assert (root.tag, root.attrib) == ("policy", {"version": VERSION})
        (enclave,) = root.iterfind("enclaves/enclave")
        assert enclave.attrib == {"path": f"/tripod/{file.stem}"}
        for profile in enclave.iterfind("profiles/profile"):
            assert profile.attrib["ns"] == "/tripod"
            for group in profile:
                (verb,) = group.attrib
                assert (group.tag, {each.tag for each in group}) == (RULES[verb][0], {RULES[verb][1]})
                assert all(re.fullmatch(r"(\*|(/|~/)?\w+(/(\w+|\*))*)", str(each.text)) for each in group)
    write_policies(tmp_path, read_policies(FOLDER))
    for file in FOLDER.glob("*.xml"):
        assert (tmp_path / file.name).read_bytes() == file.read_bytes()


class Start(NamedTuple):
    """How a start that wants security ended."""

    code: int
    errors: str


@pytest.fixture
def secured_start(tmp_path: Path) -> Start:
    """A node that shall be secured, with a keystore that holds no keys for it."""
    (tmp_path / "keys" / "enclaves" / "tripod" / "path_follower").mkdir(parents=True)
    wishes = {"ENABLE": "true", "STRATEGY": "Enforce", "KEYSTORE": str(tmp_path / "keys")}
    with private_ros(tmp_path):
        done = subprocess.run(
            [
                *(sys.executable, "-m", "softsim_ros.nodes.inverse.path_follower_node"),
                *("--ros-args", "--enclave", "/tripod/path_follower"),
            ],
            env={
                **os.environ,
                "PYTHONPATH": str(REPOSITORY),
                **{f"ROS_SECURITY_{name}": wish for name, wish in wishes.items()},
            },
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=90,
            check=False,
        )
    return Start(done.returncode, done.stderr)


@pytest.mark.slow
def test_a_node_that_cannot_be_secured_does_not_start(secured_start: Start) -> None:
    assert secured_start.code == 1
    *others, sentence = secured_start.errors.splitlines()
    assert all("[rcl]" in line for line in others)
    assert sentence.startswith("ROS_SECURITY_ENABLE is true, but no secured node can be made: ")
    assert len(sentence) <= 300


def test_security_that_is_not_enforced_is_said() -> None:
    wanted = {"ROS_SECURITY_ENABLE": "true"}
    assert (
        process.security_warning({})
        == process.security_warning({**wanted, "ROS_SECURITY_STRATEGY": "Enforce"})
        == ""
    )
    assert "open to everybody" in process.security_warning(wanted)
    assert len(process.security_warning(wanted)) <= 300
