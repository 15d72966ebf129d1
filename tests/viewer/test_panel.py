"""Controls of the page: what counts as a person's change, and what they show meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

pytest.importorskip("viser")

from softsim_ros.nodes.viewer import Control, panel


@dataclass
class Field:
    """What of viser's sliders and checkboxes a Control uses."""

    value: float | bool
    step: float | None = None


def test_a_value_that_is_on_the_page_already_is_nobodys_command() -> None:
    taken: list[float] = []
    field = Field(0.0, step=0.001)
    control = Control(field, taken.append)
    control.show(-1.04667)
    for echo in (-1.04667, -1.047, -1.0467):  # as it was, and as a browser rounds it
        control.take(echo)
    assert taken == []
    control.take(-1.048)
    control.take(-1.048)
    assert taken == [-1.048]


def test_a_switch_acts_when_it_is_turned() -> None:
    taken: list[bool] = []
    control = Control(Field(True), taken.append)
    for value in (True, False, False, True):
        control.take(value)
    assert taken == [False, True]


def test_what_a_person_has_set_stays_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(panel.time, "monotonic", lambda: now)
    field = Field(0.0, step=0.1)
    control = Control(field, lambda _: None)
    field.value = 2.0  # viser's own doing when a browser tells it
    control.take(2.0)
    control.show(1.0)
    assert field.value == 2.0
    now += panel.HOLD_S + 0.1
    control.show(1.0)
    assert field.value == 1.0


def test_a_click_that_waits_while_the_page_is_refreshed_is_not_undone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, taken = 100.0, list[bool]()
    monkeypatch.setattr(panel.time, "monotonic", lambda: now)
    field = Field(True)
    control = Control(field, taken.append)
    for clicked in (False, True, False):
        field.value = clicked  # viser's own doing, before the frame that takes it
        control.show(not clicked)
        assert field.value == clicked
        control.take(clicked)
        control.show(clicked)
        now += panel.HOLD_S + 0.1
    assert taken == [False, True, False]


def test_what_the_robot_refuses_is_shown_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(panel.time, "monotonic", lambda: now)
    field = Field(False)
    control = Control(field, lambda _: None)
    field.value = True
    control.take(True)
    now += panel.HOLD_S + 0.1
    control.show(False)
    assert field.value is False
    field.value = True  # by a browser that told nobody: seen at the second look
    control.show(False)
    control.show(False)
    assert field.value is False
