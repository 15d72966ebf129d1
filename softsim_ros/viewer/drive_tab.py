"""The tab Drive: bars and sliders of the joints, the table of keys, sending to the servo board."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

from softsim_core.scene.joint import JointDescription
from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.state import enforces_limits
from softsim_ros.keys.keyboard import Keyboard
from softsim_ros.viewer import readings
from softsim_ros.viewer.hotkeys import hotkeys, key_label, key_rows, page_keys
from softsim_ros.viewer.panel import Control, Inbox, Shown
from softsim_ros.viewer.readings import box
from softsim_ros.viewer.units import command_of, joint_range, slider_label, slider_value

HINT: Final = (
    "In the picture: drag turns, right drag moves, the wheel zooms, <b>Shift + drag pulls</b> the silicone. "
    "Click here first, then keys act with Ctrl. Tab <b>View</b>: stress, what lies inside, pictures."
)


class Hint:
    """Words for the first minute, until somebody closes them."""

    shown = True

    def close(self, handles: Sequence[Any]) -> None:
        """Take them away for as long as the page is served."""
        self.shown = False
        for handle in handles:
            handle.remove()


class DriveTab:
    """What drives the robot.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        robot: The scene.
        client: What is driven.
        keyboard: What the keys do.
        hint: Whether people are told how the mouse works.
    """

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        robot: RobotDescription,
        client: RobotClient,
        keyboard: Keyboard,
        hint: Hint,
    ) -> None:
        self._robot, self._client = robot, client
        self._bars = Shown(gui.add_html(""))
        self._sliders: list[Control] = []
        for joint in robot.joints:
            start = slider_value(joint, joint.rest)
            slider = gui.add_slider(slider_label(joint), *joint_range(joint), start)
            self._sliders.append(inbox.on_change(slider, partial(_move, client, joint)))
        with gui.add_folder("Keys, here with Ctrl"):
            for words, buttons in key_rows(robot):
                row = gui.add_button_group(words, tuple(buttons))
                inbox.on_press(
                    row, {button: partial(keyboard.click, name) for button, name in buttons.items()}
                )
        for name, binding in page_keys(robot).items():
            label = key_label(name, binding)
            for number, (hotkey, modifier) in enumerate(hotkeys(name)):
                title = label if number == 0 else f"{label} ({number + 1})"
                command: Any = gui.add_command(title, hotkey=hotkey, modifier=modifier)
                inbox.on_key(command, partial(keyboard.press_with_ctrl, name))
        inbox.on_click(gui.add_button("Start / stop sending to the board"), client.bridge.toggle)
        if hint.shown:
            handles = (gui.add_html(box(HINT)), gui.add_button("Close the hint", color="gray"))
            inbox.on_click(handles[1], partial(hint.close, handles))

    def refresh(self) -> None:
        """Show the joints."""
        joints, state = self._robot.joints, self._client.state
        targets = state.commanded if state.commanded is not None else state.measured
        enforced = enforces_limits(state, self._robot)
        self._bars.show(readings.joint_bars(joints, state.measured, targets, state.efforts, enforced))
        if targets is not None:
            for joint, slider, target in zip(joints, self._sliders, targets, strict=True):
                slider.show(slider_value(joint, target))


def _move(client: RobotClient, joint: JointDescription, shown: float) -> None:
    client.joints.move(joint.name, command_of(joint, shown))
