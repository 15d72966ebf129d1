"""The tab Tune: parameters of the simulator that act at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.parameters import Parameters
from softsim_ros.viewer.panel import Control, Inbox
from softsim_ros.viewer.tuning import Tunable, tunables


class TuneTab:
    """A control for each tunable parameter.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        robot: The scene.
        parameters: Those of the simulator.
    """

    def __init__(self, gui: Any, inbox: Inbox, robot: RobotDescription, parameters: Parameters) -> None:
        self._controls: dict[str, tuple[Tunable, Control]] = {}
        for tunable in tunables(robot):
            if tunable.is_switch:
                handle = gui.add_checkbox(tunable.label, bool(tunable.start), hint=tunable.help)
            else:
                handle = gui.add_slider(
                    tunable.label,
                    tunable.lower,
                    tunable.upper,
                    tunable.step,
                    tunable.start,
                    hint=tunable.help,
                )
            self._controls[tunable.name] = (
                tunable,
                inbox.on_change(handle, partial(_tune, parameters, tunable)),
            )
        parameters.follow(list(self._controls), self.show)

    def show(self, values: Mapping[str, Any]) -> None:
        """Show values of the simulator's parameters, in SI."""
        for name, value in values.items():
            if name in self._controls:
                tunable, control = self._controls[name]
                control.show(tunable.shown(value))


def _tune(parameters: Parameters, tunable: Tunable, value: Any) -> None:
    parameters.set(tunable.name, tunable.si(value))
