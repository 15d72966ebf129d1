"""The scene in which a new robot hangs on a rigid arm."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from softsim_core.errors import SceneError, listing
from softsim_core.mechanics.pose import euler_of, rotation_euler
from softsim_core.meshing.guesses import Guess
from softsim_core.scene.arm.urdf_file import RigidRobot
from softsim_core.scene.generated import on_one_line, scalar
from softsim_ros.cli.robots.new_scene import number_list

_ALONG_Z = ((0.0, -90.0, 0.0), (90.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Rotations in [deg] that turn x, y and z to z."""
_FELT = """
sensors:  # what the arm feels there: weight, and every acceleration
  - {{name: flange, kind: force_torque, on: {joint}}}
"""


def chosen_link(rigid: RigidRobot, link: str | None) -> str:
    """The link that carries: the one named, else the last one.

    Raises:
        SceneError: the arm has no such link.
    """
    if link is None:
        return rigid.last_link
    if link not in rigid.shapes:
        raise SceneError(f"{link!r} is no link of {rigid.name}; known: {listing(rigid.shapes)}")
    return link


def arm_text(name: str, urdf: Path, rigid: RigidRobot, link: str, guess: Guess) -> str:
    """The scene in YAML, which lies beside that of the robot.

    Args:
        name: Of the robot.
        urdf: The arm's file.
        rigid: What stands in it.
        link: What carries the robot.
        guess: Where the robot is held.
    """
    turned = _ALONG_Z[guess.axis]
    if guess.tilt_deg:
        upright = rotation_euler(np.radians(turned)) @ guess.axes.T
        x, y, z = np.degrees(euler_of(upright)).tolist()
        turned = (x, y, z)
    held = rotation_euler(np.radians(turned)) @ np.array(guess.held.center)
    moving = [joint.name for joint in rigid.joints if joint.kind != "fixed"]
    file, listed = on_one_line(urdf.name), on_one_line(", ".join(moving))
    carrier = _carrier(rigid, link)
    pairs = (("left", "right"), ("up", "down"))
    keys = "\n".join(
        f"  {key}: {{joints: [{scalar(joint)}], by: {sign}0.05, help: {scalar(f'move {joint}')}}}"
        for joint, both in zip(moving, pairs, strict=False)
        for key, sign in zip(both, ("", "-"), strict=True)
    )
    return f"""\
# {name}_on_arm: {name} on the arm of {file}. Commands are the arm's joints, then those of {name}.
name: {name}_on_arm
arm:
  urdf: {scalar(os.path.relpath(urdf.resolve(), Path(name).resolve()))}
  start: {{}}  # positions of its joints at the start in rad or m; others at 0: {listed}
  tools:
    # GUESS: held end at the origin of the last link, along its +z
    - robot: {name}.yaml
      on: {scalar(link)}
      pose: {{rotation_deg: {number_list(turned)}, translation: {number_list(tuple(0.0 - held))}}}
{_FELT.format(joint=scalar(carrier)) if carrier else ""}
keys:  # those of {name} are there, too
{keys or "  {}"}
"""


def _carrier(rigid: RigidRobot, link: str) -> str | None:
    """The last joint that moves before a link."""
    carried_by = {joint.child: joint for joint in rigid.joints}
    while (joint := carried_by.get(link)) is not None and joint.kind == "fixed":
        link = joint.parent
    return None if joint is None else joint.name
