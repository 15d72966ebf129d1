"""Edit the scene's file over ROS: propose edits, apply them to the running simulation, save them.

`scene/edit` (std_msgs/String) takes edits, see `messages.proposal`; `scene/proposal` (std_msgs/String,
latched) publishes the resulting scene. Services: `~/edit/begin`, `undo`, `redo`, `discard`, `apply`, `save`,
`copy` (std_srvs/Trigger). This node stores the document next to the file, so an editor opens no file itself.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import String
from std_srvs.srv import Trigger

from softsim_core.base import Array, ConfigError, SceneError, SoftSimError, write_file
from softsim_core.scene import BodyDescription, RobotDescription
from softsim_core.scene.building import Body
from softsim_core.scene.editing import RestShapes, SceneDocument, chosen_by, rebase_paths, routed_points
from softsim_core.scene.io import installed_roots, limited_to, named_files, write_description
from softsim_node import EVERY_ONE, LATCHED, answering, error_message, one_line
from softsim_ros.messages import MOST_POINTS, ChosenPoints, Proposal, read_edits, write_proposal
from softsim_ros.nodes.simulator.scene_files import NextScene, SceneBuilder, SceneFiles, files_of, reason

MOST_BYTES: Final = 4_000_000
SUFFIXES: Final = (".yaml", ".yml")


class SceneWriter:
    """Reads and writes scene files for the edit mode.

    It writes only files that the start command named and that are not part of the installation, and copies of
    a scene in the start folder, under names that are free there.

    Args:
        start_folder: Folder of the copies; None: none can be written.
    """

    def __init__(self, named: Iterable[Path], start_folder: Path | None) -> None:
        self._own = {file.absolute() for file in named}
        self._start_folder = start_folder

    def refusal(self, file: Path) -> str:
        """Return why a file must not be written, as a message; an empty string if it may be."""
        if any(file.resolve().is_relative_to(root.resolve()) for root in installed_roots()):
            return f"{file.name} came with softsim and is not overwritten; save a copy"
        if file.absolute() not in self._own:
            return f"{file.name} was not named by the start command, so it is not written; save a copy"
        try:
            status = file.lstat()
        except OSError as error:
            return f"{file} cannot be looked at ({error.strerror})"
        if not stat.S_ISREG(status.st_mode):
            return f"{file} is a link or no ordinary file, so it is not written; start with the file itself"
        if not os.access(file, os.W_OK) or not os.access(file.parent, os.W_OK):
            return f"{file} must not be written by this user; change its rights, or save a copy"
        return ""

    def read(self, file: Path) -> str:
        """Return the text of a file.

        Raises:
            ConfigError: it cannot be edited.
        """
        if file.suffix not in SUFFIXES:
            raise ConfigError(file, "", "is a program, which is edited by hand; the page edits YAML files")
        try:
            with file.open("rb") as stream:
                data = stream.read(MOST_BYTES + 1)
            if len(data) > MOST_BYTES:
                raise ConfigError(file, "", f"is longer than {MOST_BYTES} bytes; edit it by hand")
            if b"\r" in data:
                raise ConfigError(file, "", "has lines that end as under Windows; save it with those of Unix")
            return data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ConfigError(file, "", f"is not UTF-8 text (byte {error.start})") from error
        except OSError as error:
            raise ConfigError(file, "", f"cannot be read ({error.strerror or error})") from error

    def write(self, file: Path, text: str, before: str) -> None:
        """Write a file whose present text is still `before`.

        Raises:
            ConfigError: it must not be written, cannot be written, or has changed.
        """
        if refusal := self.refusal(file):
            raise ConfigError(file, "", f"not saved: {refusal}")
        if self.read(file) != before:
            raise ConfigError(
                file,
                "",
                "not saved: it was changed on the disk since it was read; discard the proposal to take that, "
                "or save a copy",
            )
        try:
            write_file(file, text)
        except OSError as error:
            raise ConfigError(file, "", f"not saved: {error.strerror}") from error

    def copy(self, name: str, text: str) -> Path:
        """Write a new file NAME.yaml in the start folder; later calls may write it again.

        Raises:
            ConfigError: there is one already, or it cannot be written.
        """
        if self._start_folder is None:
            raise ConfigError(f"{name}.yaml", "", "not saved: the folder of the start command is gone")
        file = self._start_folder / f"{name}.yaml"
        try:
            write_file(file, text, replaces=False)
        except FileExistsError as error:
            raise ConfigError(file, "", "not saved: there is a file of this name; move it away") from error
        except OSError as error:
            raise ConfigError(file, "", f"not saved: {error.strerror}") from error
        self._own.add(file.absolute())
        return file


OFF = "nothing is edited yet; begin first (service simulator/edit/begin)"


class Running(NamedTuple):
    """Access to the running scene, to which edits are applied.

    Attributes:
        files: Returns the files of the running scene.
        bodies: Returns its bodies, each as description and as built.
        run_in_background: Runs a long task in the background while the simulation continues.
        go_on_with: Replaces the running scene.
    """

    files: Callable[[], SceneFiles]
    bodies: Callable[[], list[tuple[BodyDescription, Body]]]
    run_in_background: Callable[[Callable[[], NextScene]], Awaitable[NextScene]]
    go_on_with: Callable[[NextScene], None]


class SceneEditing:
    """Topics and services of the edit mode, which belong to `node`; it publishes refusals."""

    def __init__(self, node: Any, running: Running, builder: SceneBuilder, writer: SceneWriter) -> None:
        self._node, self._running, self._builder, self._writer = node, running, builder, writer
        self._document: SceneDocument | None = None
        self._source: Path | None = None
        self._runs = ""
        self._shapes = RestShapes()
        self._revision = time.time_ns()
        self._proposal = node.create_publisher(String, "scene/proposal", LATCHED)
        node.create_subscription(String, "scene/edit", self._on_edit, EVERY_ONE)
        for action in (self.begin, self.undo, self.redo, self.discard, self.save, self.copy):
            node.create_service(Trigger, f"~/edit/{action.__name__}", self._answering(action))
        waiting = ReentrantCallbackGroup()
        node.create_service(Trigger, "~/edit/apply", self._on_apply, callback_group=waiting)

    # --- requests -------------------------------------------------------------------------------------

    def begin(self) -> str:
        """Read the file of the running scene, unless it is being edited already; return a message.

        Raises:
            SoftSimError: it cannot be edited.
        """
        document = self._document
        if document is not None and (
            document.is_changed or self._writer.read(document.file) == document.saved
        ):
            return f"editing {document.file.name}"
        return self._open()

    def undo(self) -> str:
        """Undo the last change; return a message."""
        return "undone" if self._open_document().undo() else "nothing is left to undo"

    def redo(self) -> str:
        """Redo the change that was undone last; return a message."""
        return "done again" if self._open_document().redo() else "nothing is left to do again"

    def discard(self) -> str:
        """Discard the proposal and read the file as it is now; return a message."""
        self._open_document()
        return f"proposal discarded; {self._open()}"

    def save(self) -> str:
        """Write the proposal into its file; return a message.

        Raises:
            ConfigError: it must not be written, cannot be written, or has changed.
        """
        document = self._open_document()
        self._writer.write(document.file, document.text, document.saved)
        document.note_saved()
        if self._is_applied(document):
            self._running.files().note_saved()
        hint = "" if self._is_applied(document) else "; apply it to see it run"
        return f"saved to {document.file}{hint}"

    def copy(self) -> str:
        """Write the proposal into a new file of the start folder; return a message.

        Raises:
            ConfigError: it cannot be written.
        """
        document = self._open_document()
        paths = {*files_of(document.robot), *named_files(document.robot)} - {document.file}
        text = rebase_paths(document.text, document.file, paths)
        file = self._writer.copy(document.robot.name, text)
        applied = self._is_applied(document)
        self._document = self._make_document(file, text)
        self._runs = text if applied else self._runs
        return f"saved as {file}, which is edited from now on; start it with: softsim up {file}"

    async def apply(self) -> str:
        """Build the proposed scene and continue with it; return a message.

        Raises:
            SoftSimError: it cannot be built.
        """
        document, files = self._open_document(), self._running.files()
        text = document.text
        try:
            built = await self._running.run_in_background(lambda: self._builder.build_proposed(files, text))
        except Exception as error:
            raise SceneError(f"not applied: {reason(error)}") from error
        self._running.go_on_with(built)
        self._runs = text
        return "applied: the scene restarts as proposed"

    def scene_replaced(self) -> None:
        """Update the document after another scene, or the same one reloaded, has started to run."""
        files, document = self._running.files(), self._document
        if document is None:
            return
        if files.scene.source is None or files.scene.source != self._source:
            self._document = None
            self._publish_proposal("another scene runs; begin again to edit it")
        elif files.text is None:
            self._publish_proposal(self._done(self._follow))

    # --- proposals -------------------------------------------------------------------------------------

    def _publish_proposal(self, message: str) -> None:
        self._revision += 1
        message, document = one_line(message), self._document
        proposal, description = Proposal(self._revision, message=message), ""
        if document is not None:
            description = write_description(document.robot)
            proposal = Proposal(
                self._revision,
                robot=document.robot,
                file=str(document.file),
                unsaved=self._writer.refusal(document.file),
                undoable=document.undoable,
                redoable=document.redoable,
                is_changed=document.is_changed,
                is_applied=self._is_applied(document),
                message=message,
                chosen=self._find_chosen(document.robot),
                routes=_routes(document.robot),
            )
        self._proposal.publish(String(data=write_proposal(proposal, description)))

    def _find_chosen(self, robot: RobotDescription) -> tuple[ChosenPoints, ...]:
        found = []
        try:
            every = chosen_by(robot.scene, self._shapes)
        except Exception as error:  # such as a mesh that cannot be used, with which apply would fail too
            return (ChosenPoints("scene", 0, np.zeros((0, 3)), error_message(error)),)
        for each in every:
            stride = -(-len(each.points) // MOST_POINTS) or 1
            found.append(ChosenPoints(each.part, len(each.points), each.points[::stride], each.problem))
        return tuple(found)

    # --- the document ---------------------------------------------------------------------------------

    def _open(self) -> str:
        """Read the file of the running scene; return a message."""
        self._document = None
        source = self._running.files().scene.source
        if source is None:
            raise SceneError("this scene came from no file, so there is none to edit")
        text = self._writer.read(source)
        self._document, self._source = self._make_document(source, text), source
        self._runs = self._running.files().text or text
        for description, body in self._running.bodies():
            self._shapes.take(description, body)
        return f"editing {source.name}"

    def _make_document(self, file: Path, text: str) -> SceneDocument:
        """Return a document that may run only the running scene's programs, such as an arm's xacro file."""
        with limited_to(self._running.files().programs):
            return SceneDocument(file, text)

    def _follow(self) -> str:
        """Record the text of the reloaded files; a proposal without changes is read again from them."""
        document = self._open_document()
        assert self._source is not None  # every document has one
        self._runs = self._writer.read(self._source)
        if document.file == self._source and not document.is_changed and document.saved != self._runs:
            return self._open()
        return ""

    def _open_document(self) -> SceneDocument:
        if self._document is None:
            raise SceneError(OFF)
        return self._document

    def _is_applied(self, document: SceneDocument) -> bool:
        return document.text == self._runs

    def _on_edit(self, message: String) -> None:
        def change() -> str:
            document, files = self._open_document(), self._running.files()
            edits, stroke = read_edits(message.data)
            document.take(files.propose(document, edits), stroke)
            return ""

        self._publish_proposal(self._done(change))

    def _done(self, action: Callable[[], str]) -> str:
        """Run an action and return its message; if it fails, log and return why."""
        try:
            return action()
        except Exception as error:  # a remote request may fail anywhere
            message = error_message(error)
            self._node.refuse(message)
            return message

    def _answering(self, action: Callable[[], str]) -> Callable[[Any, Any], Trigger.Response]:
        answer = answering(action)

        def answer_and_publish(request: Any, response: Any) -> Trigger.Response:
            self._publish_proposal(answer(request, response).message)
            return response

        return answer_and_publish

    async def _on_apply(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.success, response.message = True, await self.apply()
        except SoftSimError as error:
            response.success, response.message = False, str(error)
        self._publish_proposal(response.message)
        return response


def _routes(robot: RobotDescription) -> dict[str, Array]:
    """Return pull point and points in [m] of each cable in the world, by joint name."""
    routes: dict[str, Array] = {}
    for joint in robot.joints:
        if joint.kind == "cable":
            with suppress(SoftSimError):  # the file with its points is gone
                routes[joint.name] = np.array(routed_points(robot, joint.name))[:MOST_POINTS]
    return routes
