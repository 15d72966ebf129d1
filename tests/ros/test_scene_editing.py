"""The simulator's doors for edits: proposed, applied, saved; refused in a sentence, and what runs goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from edited_scenes import save  # noqa: E402
from node_processes import Client, parameter_words  # noqa: E402
from rcl_interfaces.srv import SetParametersAtomically  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from waiting import BUILD_S  # noqa: E402

from softsim_core import load_scene  # noqa: E402
from softsim_core.base import Box  # noqa: E402
from softsim_core.scene.editing import Edit, Put, add_attachment, add_cable  # noqa: E402
from softsim_core.scene.io import Item, config_file  # noqa: E402
from softsim_ros.messages import Proposal, read_proposal, write_edits  # noqa: E402

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BARE = f"""\
# a finger of which nothing is known but its mesh
name: finger
bodies:
  - name: part
    mesh: {{file: {config_file("meshes/finger_coarse.vtk")}}}  # its mesh
    material: {{young_modulus: 1.8e+6, poisson_ratio: 0.45}}
    density: 1070.0
"""
BASE = Box(center=(0.0075, 0.0, 0.0025), size=(0.02, 0.004, 0.02))


class Edited:
    """A simulator whose scene is edited."""

    def __init__(self, process: Any, client: Client, file: Path, until: Callable[..., bool]) -> None:
        self.process, self.client, self.file, self.until = process, client, file, until
        self.told = self.client.collect(String, "scene/proposal", LATCHED)
        self.states = self.client.collect(JointState, "joint_states", 5)

    def ask(self, name: str) -> tuple[bool, str]:
        answer = self.client.call(Trigger, f"simulator/edit/{name}")
        return answer.success, answer.message

    @property
    def newest(self) -> Proposal:
        return read_proposal(self.told[-1].data)

    def after(self, action: Callable[[], Any]) -> Proposal:
        """What is told after an action."""
        seen = len(self.told)
        action()
        assert self.until(lambda: len(self.told) > seen)
        return self.newest

    def edit(self, *edits: Edit) -> Proposal:
        return self.send(write_edits(edits))

    def send(self, text: str) -> Proposal:
        return self.after(lambda: self.client.publish("scene/edit", String(data=text)))

    def overrides(self, text: str) -> bool:
        """Lay values over the scene's file."""
        message = Parameter("overrides", value=text).to_parameter_msg()
        request = SetParametersAtomically.Request(parameters=[message])
        answer = self.client.call(SetParametersAtomically, "simulator/set_parameters_atomically", request)
        return bool(answer.result.successful)

    def runs(self) -> list[str]:
        """Names of the joints that run now."""
        seen = len(self.states)
        assert self.until(lambda: len(self.states) > seen + 2)
        return list(self.states[-1].name)


@pytest.fixture(scope="module")
def simulator(
    start_process: Any,
    ros_domain: int,
    spin_until: Callable[..., bool],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Edited]:
    file = tmp_path_factory.mktemp("mine") / "finger.yaml"
    file.write_text(BARE)
    words = parameter_words(robot=file)
    process = start_process("softsim_ros.nodes.simulator.simulator_node", "--ros-args", *words)
    assert process.says("simulating", BUILD_S), process.output
    client = Client(ros_domain, "finger", start_process)
    yield Edited(process, client, file, spin_until)
    client.close()


@pytest.fixture
def edited(simulator: Edited) -> Edited:
    """The simulator with the bare finger, which is edited."""
    save(simulator.file, BARE)
    assert simulator.ask("begin")[0]
    assert simulator.after(lambda: simulator.ask("discard")).is_changed is False
    assert simulator.ask("apply")[0]
    assert simulator.newest.is_applied
    return simulator


def test_nothing_is_edited_before_it_begins(simulator: Edited) -> None:
    for name in ("undo", "redo", "discard", "apply", "save", "copy"):
        assert simulator.ask(name) == (
            False,
            "nothing is edited yet; begin first (service simulator/edit/begin)",
        )
    assert simulator.file.read_text() == BARE


def test_a_robot_is_built_applied_saved_and_undone(edited: Edited) -> None:
    begun = edited.newest
    assert begun.robot is not None
    assert (begun.file, begun.unsaved, begun.is_changed) == (str(edited.file), "", False)
    told = edited.edit(*add_attachment(begun.robot, "part", BASE, "world")[1])
    assert told.robot is not None
    assert told.robot.scene.attachments[0].box == BASE
    assert told.problems == ()
    assert [(each.part, each.count > 3) for each in told.chosen] == [("attachments/fixed", True)]
    assert abs(told.chosen[0].points[:, 1]).max() <= 0.002
    points = [(0.003, -0.02, 0.0125), (0.003, -0.09, 0.0125)]
    told = edited.edit(*add_cable(told.robot, "part", (0.003, 0.0105, 0.0125), points, 0.01)[1])
    assert told.routes["cable"].tolist() == [list(point) for point in points]
    assert (told.undoable, told.is_changed, told.is_applied) == (2, True, False)
    assert edited.runs() == []  # what runs is not disturbed
    assert edited.file.read_text() == BARE

    assert edited.ask("apply")[0]
    assert edited.runs() == ["cable"]
    assert edited.newest.is_applied
    assert edited.file.read_text() == BARE
    assert edited.ask("save") == (True, f"saved to {edited.file}")
    assert not edited.newest.is_changed
    assert load_scene(edited.file).scene == edited.newest.robot.scene
    text = edited.file.read_text()
    assert text.startswith(BARE)  # with its remarks

    assert edited.ask("undo") == (True, "undone")
    assert edited.newest.is_changed
    assert edited.newest.robot.joints == ()
    assert edited.ask("undo")[0]
    assert (edited.newest.undoable, edited.newest.redoable) == (0, 2)
    assert edited.ask("undo") == (True, "nothing is left to undo")
    assert edited.runs() == ["cable"]
    assert edited.ask("save")[0]
    assert edited.file.read_text() == BARE
    assert edited.ask("redo")[0]
    assert edited.ask("redo")[0]
    assert edited.ask("save")[0]
    assert edited.file.read_text() == text


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (
            Put(("bodies", Item("part"), "mesh", "file"), "/etc/hostname"),
            "name other files than the scene does",
        ),
        (
            Put(("bodies", Item("part"), "surface"), {"file": "../x.stl"}),
            "name other files than the scene does",
        ),
        (Put(("extends",), "tripod.yaml"), "name other files than the scene does"),
        (Put(("name",), "other"), "is nothing that edits change"),
        (Put(("bodies", Item("part"), "density"), "heavy"), "must be a number"),
        (Put(("attachments", Item("x")), {"name": "x", "body": "no", "to": "world"}), "exactly one of box"),
    ],
)
def test_edits_that_must_not_be_are_refused(edited: Edited, edit: Edit, sentence: str) -> None:
    told = edited.edit(edit)
    assert sentence in told.message
    assert "\n" not in told.message
    assert (told.is_changed, told.undoable) == (False, 0)
    assert edited.runs() == []


def test_what_is_no_edit_is_refused_and_the_node_lives(edited: Edited) -> None:
    for text in ("", "{", "[" * 50_000, "x" * 200_000, '{"edits": [{"at": ["dt"]}]}'):
        assert "edit refused" in edited.send(text).message
    assert edited.runs() == []


def test_what_cannot_be_built_is_not_applied_and_what_runs_goes_on(edited: Edited) -> None:
    far = Box(center=(9.0, 9.0, 9.0), size=(0.1, 0.1, 0.1))
    told = edited.edit(*add_attachment(edited.newest.robot, "part", far, "world")[1])
    assert told.problems == ("attachments/fixed: chooses no node; move or enlarge it",)
    done, sentence = edited.ask("apply")
    assert not done
    assert sentence.startswith("not applied: attachment fixed: no node of body part lies inside")
    assert edited.runs() == []


def test_a_mesh_that_cannot_be_used_is_told_and_the_node_lives(edited: Edited) -> None:
    told = edited.edit(Put(("bodies", Item("part"), "mesh", "placement"), {"scale": 1e-300}))
    assert [each.part for each in told.chosen] == ["scene"]
    assert told.problems
    assert not edited.ask("apply")[0]
    assert edited.runs() == []


@pytest.mark.parametrize("step", ["x" * 40_000, "bodies\n\x1b[2J"])
def test_what_is_told_of_an_edit_is_one_short_line(edited: Edited, step: str) -> None:
    sentence = edited.edit(Put((step, step), 1.0)).message
    assert "nothing that edits change" in sentence
    assert len(sentence) <= 300
    assert sentence.isprintable()


def test_a_file_that_somebody_else_changes_is_not_overwritten(edited: Edited) -> None:
    edited.edit(Put(("dt",), 0.005))
    save(edited.file, BARE + "# and this\n")
    done, sentence = edited.ask("save")
    assert not done
    assert "changed on the disk since it was read" in sentence
    assert edited.file.read_text() == BARE + "# and this\n"
    assert edited.ask("discard")[0]
    assert edited.edit(Put(("dt",), 0.005)).is_changed
    assert edited.ask("save") == (True, f"saved to {edited.file}; apply it to see it run")
    assert edited.file.read_text() == BARE + "# and this\ndt: 0.005\n"


def test_overrides_are_laid_over_what_is_applied_and_reload_takes_the_file(edited: Edited) -> None:
    told = edited.edit(*add_attachment(edited.newest.robot, "part", BASE, "world")[1])
    points = [(0.003, -0.02, 0.0125), (0.003, -0.09, 0.0125)]
    edited.edit(*add_cable(told.robot, "part", (0.003, 0.0105, 0.0125), points, 0.01)[1])
    assert edited.ask("apply")[0]
    assert edited.overrides("dt: 0.005")
    assert edited.runs() == ["cable"]
    assert edited.overrides("")
    assert edited.client.call(Trigger, "simulator/reload").success
    assert edited.runs() == []
    assert edited.until(lambda: not edited.newest.is_applied)
    assert edited.newest.undoable == 2


def test_a_link_is_not_written(edited: Edited, tmp_path: Path) -> None:
    away = tmp_path / "precious.yaml"
    away.write_text(BARE)
    edited.file.unlink()
    edited.file.symlink_to(away)
    try:
        edited.edit(Put(("dt",), 0.005))
        done, sentence = edited.ask("save")
        assert not done
        assert "is a link" in sentence
        assert away.read_text() == BARE
    finally:
        edited.file.unlink()
