"""Make the pictures and films of the tutorials from their scenes, or check that they show today's scenes.

From the checkout: `.softsim/venv/bin/python docs/tutorials/pictures.py` makes all, with names some.
With `--check` it makes none: it runs the scenes to the same moments and compares the numbers kept in them.
"""

from __future__ import annotations

import argparse
import json
import struct
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parents[1]))
sys.path.insert(0, str(FOLDER))

from softsim_core import (  # noqa: E402
    InverseController,
    Pose,
    Simulation,
    load_scene,
    quaternion_of,
    rotation_euler,
)

PICTURES = FOLDER / "pictures"
KEYWORD = "Scene state"
TOLERANCES = {"lengths_mm": 1.0, "tensions_n": 0.5, "pressures_kpa": 0.5}
"""A picture is of today's scene when all numbers it carries are this near."""

FRAME_S, MOST_FRAMES = 0.08, 36
"""A film has a frame this often, in simulated time in [s], or more rarely where it is long."""


@dataclass(frozen=True)
class Shot:
    """A scene at a telling moment.

    Attributes:
        scene: Name of the scene.
        seconds: Simulated time at which the picture is taken.
        start: Begin with the start animation.
        moves: Commands by the time in [s] at which they are given.
        goal: Position in [m] and Euler angles in [rad] of the effector, by inverse control from 0.5 s on.
        hidden: Rigid bodies that are left out.
        ghost: Draw the outline at rest, too.
        view: Elevation and azimuth of the camera in [deg].
        film: With a film from the start to that moment.
    """

    scene: str
    seconds: float
    start: bool = False
    moves: dict[float, tuple[float, ...]] = field(default_factory=dict)
    goal: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    hidden: tuple[str, ...] = ()
    ghost: bool = False
    view: tuple[float, float] = (24.0, -60.0)
    film: bool = False

    @property
    def picture(self) -> Path:
        """Where the moment is."""
        return PICTURES / f"{self.scene}.png"

    @property
    def files(self) -> list[Path]:
        """The picture, and the film where there is one."""
        return [self.picture, self.picture.with_suffix(".gif")] if self.film else [self.picture]


FINGER = (18.0, -20.0)
GRIPPER = (12.0, -25.0)
AIR = (14.0, -65.0)
SHOTS = (
    Shot("tripod_step_1", 0.05, ghost=True),
    Shot("tripod_step_2", 0.06, ghost=True),
    Shot("tripod_step_3", 1.0, ghost=True, film=True),
    Shot("tripod_step_4_1", 1.0),
    Shot("tripod_step_4_2", 0.06),
    Shot("tripod_step_4_3", 1.2, film=True),
    Shot("tripod_step_5", 2.0, start=True, moves={0.5: (-1.0965, -1.4965, -1.4965)}, film=True),
    Shot("tripod_step_6", 2.5, moves={1.5: (-1.0467, -1.0467, -1.0467)}, hidden=("table",), film=True),
    Shot("tripod_step_7", 1.0),
    Shot("tripod_step_8_1", 1.5, goal=((0.010, 0.0, 0.040), (0.0, 0.0, 0.0)), film=True),
    Shot(
        "tripod_step_8_2", 1.0, moves={0.0: (0.020, 0.0), 0.6: (0.020, -0.15)}, view=(40.0, -75.0), film=True
    ),
    Shot(
        "tripod_step_8_3",
        2.0,
        start=True,
        goal=((0.0, 0.0, 0.045), (-0.15, 0.0, 0.0)),
        view=(35.0, -75.0),
        film=True,
    ),
    Shot("tripod_step_9", 1.5, goal=((0.0, 0.0, 0.045), (0.0, 0.25, 0.0)), film=True),
    Shot("gripper_step_1", 0.5),
    Shot("gripper_step_2", 0.06, ghost=True, view=FINGER),
    Shot("gripper_step_2_2", 1.0, ghost=True, view=FINGER, film=True),
    Shot("gripper_step_3", 1.5, ghost=True, moves={0.0: (0.010,)}, view=FINGER, film=True),
    Shot("gripper_step_4", 2.0, ghost=True, moves={0.0: (0.030,)}, view=FINGER, film=True),
    Shot("gripper_step_5", 2.0, moves={0.0: (0.008, 0.008, 0.008, 0.0, 0.0)}, view=GRIPPER, film=True),
    Shot(
        "gripper_step_0",
        4.5,
        moves={
            0.0: (0.0, 0.0, 0.0, -0.05, 0.0),
            1.5: (0.012, 0.012, 0.012, -0.05, 0.0),
            3.0: (0.012, 0.012, 0.012, -0.02, 0.0),
        },
        view=GRIPPER,
        film=True,
    ),
    Shot("pneu_step_1", 1.6, ghost=True, view=AIR),
    Shot("pneu_step_2", 2.4, ghost=True, moves={0.0: (1.4e-6,)}, view=AIR, film=True),
    Shot("pneu_step_3", 2.4, ghost=True, moves={0.0: (9e-7,)}, view=AIR, film=True),
    Shot("pneu_step_4", 2.4, ghost=True, moves={0.0: (8e-6, 0.0, 0.0)}, view=AIR, film=True),
)


def play(shot: Shot) -> Iterator[tuple[Simulation, Pose | None]]:
    """One simulation after each of its steps, the last at the shot's moment; the goal where there is one."""
    simulation = Simulation(load_scene(shot.scene))
    inverse = goal = None
    if shot.start:
        simulation.start_animation()
    for step in range(round(shot.seconds / simulation.dt)):
        command = shot.moves.get(round(step * simulation.dt, 6))
        if command is not None:
            simulation.command(command)
        if shot.goal is not None and simulation.time >= 0.5:
            if inverse is None:
                inverse = InverseController(simulation.robot)
                inverse.start(simulation.joint_targets, simulation.base_shift)
                position, angles = shot.goal
                goal = Pose(np.array(position), quaternion_of(rotation_euler(np.array(angles))))
                inverse.set_goal(goal)
            inverse.tick(simulation.effector_pose)
            simulation.command(inverse.command)
        simulation.step()
        yield simulation, goal


def played(shot: Shot) -> tuple[Simulation, Pose | None]:
    """The simulation at the shot's moment, and the goal where there is one."""
    return deque(play(shot), maxlen=1)[0]


def state_of(simulation: Simulation) -> dict[str, list[float]]:
    """Where everything is, in few numbers: places of bodies in mm, tensions in N, pressures in kPa."""
    lengths = [pose.position for pose in simulation.rigid_poses]
    if len(points := simulation.visual_points()):
        lengths += [points.min(axis=0), points.max(axis=0), points.mean(axis=0)]
    return {
        "lengths_mm": [round(1e3 * value, 3) for each in lengths for value in each.tolist()],
        "tensions_n": _multipliers(simulation, "cable", 1.0),
        "pressures_kpa": _multipliers(simulation, "chamber", 1e-3),
    }


def _multipliers(simulation: Simulation, kind: str, unit: float) -> list[float]:
    return [round(unit * each.multiplier, 3) for each in simulation.actuators if each.kind == kind]


def kept_state(picture: Path) -> dict[str, list[float]] | None:
    """The numbers a picture or film carries, or None."""
    if picture.suffix == ".gif":
        return _comment(picture.read_bytes())
    for kind, data in _chunks(picture.read_bytes()):
        keyword, _, text = data.partition(b"\0")
        if kind == b"tEXt" and keyword == KEYWORD.encode():
            return json.loads(text)
    return None


def _chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 8
    while at < len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        yield kind, png[at + 8 : at + 8 + length]
        at += 12 + length


def _comment(gif: bytes) -> dict[str, list[float]] | None:
    """The comment among the extensions before the first image: blocks of up to 255 bytes, a 0 at the end."""
    at = 13 + (3 << (gif[10] % 8 + 1))  # after header and palette
    while gif[at] == 0x21:
        label, data, at = gif[at + 1], b"", at + 2
        while length := gif[at]:
            data, at = data + gif[at + 1 : at + 1 + length], at + 1 + length
        if label == 0xFE:
            return json.loads(data)
        at += 1
    return None


def differences(shot: Shot) -> list[str]:
    """What separates picture and film from today's scene, a sentence each."""
    today = state_of(played(shot)[0])
    return [sentence for file in shot.files if (sentence := difference(file, today))]


def difference(picture: Path, today: dict[str, list[float]]) -> str:
    """What separates a picture or film from today's state, in a sentence; empty where nothing does."""
    remedy = f"make it with {Path(__file__).name} {picture.stem}"
    kept = kept_state(picture) if picture.is_file() else None
    if kept is None:
        return f"{picture.name} is missing, or carries no state; {remedy}"
    for name, tolerance in TOLERANCES.items():
        then, now = kept.get(name, []), today[name]
        if len(then) != len(now) or not np.allclose(then, now, rtol=0.0, atol=tolerance):
            return (
                f"{picture.name} does not show {picture.stem} of today: "
                f"{name} are {now}, not {then}; {remedy}"
            )
    return ""


def make(shot: Shot) -> None:
    """Write the picture of a shot, and its film where it has one."""
    from drawing import draw, extent, save_film, save_picture

    shown = {"ghost": shot.ghost, "hidden": shot.hidden}
    simulation, goal = played(shot)
    image = draw(simulation, extent(simulation, **shown), goal=goal, view=shot.view, **shown)
    save_picture(image, shot.picture, KEYWORD, state_of(simulation))
    if not shot.film:
        return
    every = round(max(FRAME_S, shot.seconds / MOST_FRAMES) / simulation.dt)
    last = round(shot.seconds / simulation.dt)
    chosen = set(range(last, 0, -every))
    around = np.concatenate([extent(each, **shown) for step, (each, _) in _numbered(shot) if step in chosen])
    images = [
        draw(each, around, goal=goal, view=shot.view, **shown)
        for step, (each, goal) in _numbered(shot)
        if step in chosen
    ]
    save_film(images, shot.files[1], every * simulation.dt, state_of(simulation))


def _numbered(shot: Shot) -> Iterator[tuple[int, tuple[Simulation, Pose | None]]]:
    return enumerate(play(shot), start=1)


def main() -> None:
    """Make or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names of scenes; none: all")
    parser.add_argument("--check", action="store_true", help="make nothing, exit 1 where a picture is old")
    arguments = parser.parse_args()
    chosen = [shot for shot in SHOTS if not arguments.scenes or shot.scene in arguments.scenes]
    if arguments.check:
        sys.exit("\n".join(sentence for shot in chosen for sentence in differences(shot)) or 0)
    for shot in chosen:
        make(shot)


if __name__ == "__main__":
    main()
