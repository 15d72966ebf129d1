"""The tab Edit: the scene as it is proposed, what a click on a body adds, values, undo, redo, apply, save."""

from __future__ import annotations

import html
from collections.abc import Callable
from functools import partial
from pathlib import PurePath
from typing import Any, Final

from softsim_ros.messages.proposal import Proposal
from softsim_ros.viewer.edit_fields import Field
from softsim_ros.viewer.edit_mode import EditMode
from softsim_ros.viewer.edit_session import CLICKS
from softsim_ros.viewer.panel import Control, Inbox, Shown

NOTHING: Final = "(no part)"
MOST_PROBLEMS: Final = 6


class EditTab:
    """Controls of the edit mode.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        mode: What is edited, drawn and asked for.
    """

    def __init__(self, gui: Any, inbox: Inbox, mode: EditMode) -> None:
        session = mode.session
        self._gui, self._inbox, self._mode, self._session = gui, inbox, mode, session
        self._status = Shown(gui.add_html(""))
        switch = gui.add_checkbox("Edit", session.is_on, hint="shows the scene at rest, as it is proposed")
        self._switch = inbox.on_change(switch, self._turn)
        for row in (("Undo", "Redo", "Discard"), ("Apply", "Save", "Copy")):
            self._add_actions(row)
        clicks = gui.add_dropdown("A click on a body does", CLICKS, initial_value=session.click)
        self._clicks = inbox.on_change(clicks, self._choose_click)
        self._folder = gui.add_folder("Part")
        self._content: list[Any] = []
        self._fields: list[tuple[Field, Any]] = []
        self._shown: object = None
        self._part: Control | None = None
        self.refresh()

    def refresh(self) -> None:
        """Show the proposal as it is told now."""
        session, told = self._session, self._session.told
        self._switch.show(session.is_on)
        self._clicks.show(session.click)
        self._status.show(status(told) if session.is_on else "")
        fields = session.fields() if session.is_on else []
        labels = [field.label for field in fields]
        shown = (session.is_on, session.parts, session.part, session.point, session.point_names, labels)
        if shown != self._shown:
            self._shown = shown
            self._build(fields)
        pairs = zip(fields, self._fields, strict=True)
        self._fields = [(field, _follow(before, field, box)) for field, (before, box) in pairs]

    def _build(self, fields: list[Field]) -> None:
        """Make the controls of the chosen part anew."""
        for handle in self._content:
            handle.remove()
        self._content, self._fields = [], []
        session, gui = self._session, self._gui
        if not session.is_on:
            return
        with self._folder:
            parts = (NOTHING, *session.parts)
            part = gui.add_dropdown("Chosen part", parts, initial_value=session.part or NOTHING)
            self._inbox.on_change(part, self._choose)
            self._content.append(part)
            if len(session.route):
                names = session.point_names
                at = gui.add_dropdown(
                    "Point of the cable", names, initial_value=names[session.point + session.first]
                )
                self._inbox.on_change(at, self._choose_point)
                self._content.append(at)
            for field in fields:
                handle = gui.add_text(field.label, field.text)
                self._fields.append((field, handle))
                self._content.append(handle)
            if self._fields:
                self._add_button("Set values", self._write)
            if (session.part and not session.part.startswith("bodies/")) or "#" in session.part:
                self._add_button("Remove part", lambda: session.remove())
            if len(session.route):
                self._add_button("Remove point", lambda: session.remove_point())
            if session.is_free:
                self._add_button("Make it the effector", lambda: session.make_effector())

    def _add_button(self, name: str, action: Callable[[], None]) -> None:
        button = self._gui.add_button(name)
        self._inbox.on_click(button, lambda: self._mode.attempt(action))
        self._content.append(button)

    def _add_actions(self, names: tuple[str, ...]) -> None:
        actions = {name: partial(self._mode.ask, name.lower()) for name in names}
        self._inbox.on_press(self._gui.add_button_group("", names), actions)

    # --- what a person does ---------------------------------------------------------------------------

    def _turn(self, on: bool) -> None:
        self._mode.turn(on)
        self.refresh()

    def _choose_click(self, click: str) -> None:
        self._mode.attempt(lambda: self._session.choose_click(click))

    def _choose(self, part: str) -> None:
        self._attempt_and_show(lambda: self._session.choose("" if part == NOTHING else part))

    def _choose_point(self, name: str) -> None:
        self._attempt_and_show(lambda: self._session.choose_point(name))

    def _write(self) -> None:
        self._session.write([(field, box.value) for field, box in self._fields if box.value != field.text])

    def _attempt_and_show(self, choose: Callable[[], None]) -> None:
        def chosen() -> None:
            choose()
            self._mode.show()
            self.refresh()

        self._mode.attempt(chosen)


def _follow(before: Field, field: Field, box: Any) -> Any:
    """The box of a field with its newest text, unless a person has written into it."""
    if box.value == before.text != field.text:
        box.value = field.text
    return box


def status(told: Proposal | None) -> str:
    """What to know about a proposal, as HTML."""
    if told is None:
        return "waiting for the simulator ..."
    if told.robot is None:
        return html.escape(told.sentence)
    saved = "not saved" if told.is_changed else "saved"
    applied = "runs" if told.is_applied else "not applied"
    file, name = html.escape(told.file), html.escape(PurePath(told.file).name)
    lines = [
        f"<b title='{file}'>{name}</b>: {saved}, {applied}",
        f"{told.undoable} to undo, {told.redoable} to redo",
    ]
    if told.unsaved:
        lines.append(html.escape(told.unsaved))
    lines += [
        f"<span style='color:#c92a2a'>{html.escape(each)}</span>" for each in told.problems[:MOST_PROBLEMS]
    ]
    return '<div style="font-size:0.85em;padding:0 0.7em">' + "<br>".join(lines) + "</div>"
