"""Controls of the page: what counts as a person's change, and what they show meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

pytest.importorskip("viser")

from softsim_ros.viewer import panel
from softsim_ros.viewer.panel import Control


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
