"""The tab Drive: bars and sliders of the joints, a button and a hotkey for every key, the servo board."""

from __future__ import annotations

from functools import partial
from typing import Any

from softsim_core.scene.description import JointDescription
from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.state import enforces_limits
from softsim_ros.keys.keyboard import Keyboard
from softsim_ros.viewer import readings
from softsim_ros.viewer.hotkeys import hotkeys, key_label, page_keys
from softsim_ros.viewer.panel import Control, Inbox, Shown
from softsim_ros.viewer.units import command_of, joint_range, slider_label, slider_value


class DriveTab:
    """What drives the robot.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        robot: The scene.
        client: What is driven.
        keyboard: What the keys do.
    """

    def __init__(
        self, gui: Any, inbox: Inbox, robot: RobotDescription, client: RobotClient, keyboard: Keyboard
    ) -> None:
        self._robot, self._client = robot, client
        self._bars = Shown(gui.add_html(""))
        self._sliders: list[Control] = []
        for joint in robot.joints:
            start = slider_value(joint, joint.rest)
            slider = gui.add_slider(slider_label(joint), *joint_range(joint), start)
            self._sliders.append(inbox.on_change(slider, partial(_move, client, joint)))
        with gui.add_folder("Keys"):
            for name, binding in page_keys(robot).items():
                label = key_label(name, binding)
                inbox.on_click(gui.add_button(label), partial(keyboard.click, name))
                for number, (hotkey, modifier) in enumerate(hotkeys(name)):
                    title = label if number == 0 else f"{label} ({number + 1})"
                    command: Any = gui.add_command(title, hotkey=hotkey, modifier=modifier)
                    inbox.on_key(command, partial(keyboard.press_with_ctrl, name))
        with gui.add_folder("Servo board"):
            inbox.on_click(gui.add_button("Start / stop sending"), client.bridge.toggle)
            stop = gui.add_button("E-STOP", color="red", hint="hold the servos still, latched")
            inbox.on_click(stop, client.bridge.e_stop)
            inbox.on_click(gui.add_button("Release e-stop"), client.bridge.clear_e_stop)

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
