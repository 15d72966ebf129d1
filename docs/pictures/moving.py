"""Make docs/pictures/moving.webp: four robots of the suite, stepped in simulated time.

From the checkout, with Pillow (the extra `viewer` brings it):
`.softsim/venv/bin/python docs/pictures/moving.py`.
`--still FILE` writes one picture of the middle of the motion instead.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

FOLDER = Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER.parents[1]), str(FOLDER)]

from rendering import Camera, Surface, neighbours, render, tube  # noqa: E402

from softsim_core import Pose, Shape, Simulation, load_scene, rotation_of, surface_of  # noqa: E402
from softsim_core.base import Array  # noqa: E402

FRAMES, PERIOD_S = 40, 0.07
TILE = (432, 330)
GAP = 4
SERVO, HORN = (0.13, 0.33, 0.60), (0.93, 0.94, 0.95)

Motion = Callable[[float], Sequence[float]]
"""Commands by the share of the clip that has passed; the end is the beginning."""


def wave(share: float, place: float = 0.0) -> float:
    """A sine of the clip's length."""
    return math.sin(2.0 * math.pi * (share - place))


@dataclass(frozen=True)
class Robot:
    """What is shown of a robot.

    Attributes:
        scene: Its name.
        motion: What its joints are told.
        azimuth, elevation: Direction to the camera in [deg].
        colour: Of its soft bodies; None: the scene's.
        depth: Length in [m] on which they absorb light; 0: opaque.
        hidden: Names of rigid bodies that are left out.
        start: Its start animation is played first.
    """

    scene: str
    motion: Motion
    azimuth: float
    elevation: float
    colour: tuple[float, float, float] | None = None
    depth: float = 0.0
    hidden: tuple[str, ...] = ()
    start: bool = False


def tripod(share: float) -> Sequence[float]:
    """A wave that goes round."""
    return [-1.05 + 0.36 * wave(share, k / 3.0) for k in range(3)]


def gripper(share: float) -> Sequence[float]:
    """Down, closed, up with the cube, and back."""
    times = np.array([0.0, 0.15, 0.3, 0.45, 0.52, 0.67, 0.82, 1.0])
    height = np.interp(share, times, [-0.03, -0.05, -0.05, -0.03, -0.03, -0.05, -0.05, -0.03])
    pull = np.interp(share, times, [0.0, 0.0, 0.012, 0.012, 0.012, 0.012, 0.0, 0.0])
    return [*[float(pull)] * 3, float(height), 0.0]


def finger(share: float) -> Sequence[float]:
    """In goes the air, and out."""
    return [5.5e-7 - 7.5e-7 * math.cos(2.0 * math.pi * share)]


def emio(share: float) -> Sequence[float]:
    """Four legs lift one after the other."""
    return [sign * (0.75 + 0.45 * wave(share, k / 4.0)) for k, sign in enumerate((1, -1, 1, -1))]


ROBOTS = (
    Robot("tripod", tripod, -62.0, 26.0, (0.93, 0.42, 0.28), 0.010, start=True),
    Robot("cable_gripper", gripper, -50.0, 14.0, (0.10, 0.66, 0.62), 0.009, hidden=("floor",)),
    Robot("pneu_finger", finger, -58.0, 12.0, (0.97, 0.66, 0.22), 0.009),
    Robot("emio", emio, -52.0, 18.0, (0.26, 0.42, 0.85)),
)


class Shown:
    """A running robot, as surfaces."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.simulation = simulation = Simulation(load_scene(robot.scene))
        self._triangles, self._smooth, self._looks = [], [], []
        rest, first = simulation.visual_rest_points, 0
        for body, described in zip(simulation.bodies, simulation.scene.bodies, strict=True):
            last = first + len(body.surface.points)
            corner = simulation.visual_triangles[:, 0]
            chosen = simulation.visual_triangles[(first <= corner) & (corner < last)]
            self._triangles.append(chosen)
            self._smooth.append(neighbours(rest, chosen))
            self._looks.append(robot.colour or described.colour[:3])
            first = last
        if robot.start:
            simulation.start_animation()
            self._advance(1.0)
        self._ends = self._carried()

    def surfaces(self) -> Iterator[Surface]:
        """What it looks like now."""
        points = self.simulation.visual_points()
        for triangles, smooth, colour in zip(self._triangles, self._smooth, self._looks, strict=True):
            yield Surface(points, triangles, colour, self.robot.depth, 0.30, smooth)
        yield from self._rigid()
        yield from self._servos()
        for view in self.simulation.actuators:
            line = np.asarray(view.points)
            if len(line) > 1:
                yield Surface(*tube(line, 6e-4), (0.20, 0.22, 0.26))

    def frames(self, count: int) -> Iterator[list[Surface]]:
        """Surfaces at each picture of a clip that repeats itself."""
        for number in range(-count, count):  # once round to come to what repeats itself
            self.simulation.command(self.robot.motion((number % count) / count))
            self._advance(PERIOD_S * FRAMES / count)
            if number >= 0:
                yield list(self.surfaces())

    def _advance(self, seconds: float) -> None:
        for _ in range(round(seconds / self.simulation.dt)):
            self.simulation.step()

    def _rigid(self) -> Iterator[Surface]:
        poses = zip(self.simulation.rigid_bodies, self.simulation.rigid_poses, strict=True)
        for body, pose in poses:
            if body.name not in self.robot.hidden:
                points, triangles = body.surface.points, body.surface.triangles
                yield Surface(
                    _placed(points, pose),
                    triangles,
                    tuple(body.colour[:3]),
                    smooth=neighbours(points, triangles),
                )

    def _servos(self) -> Iterator[Surface]:
        """Servo of each joint that has a horn, and a bar from its axis to what it carries."""
        frames = self.simulation.frames()
        for name, end in self._ends.items():
            yield _box(frames[name], (0.022, 0.012, 0.020), (0.0, 0.0, -0.014), SERVO)
            line = _placed(np.array([np.zeros(3), end]), frames[f"{name}_horn"])
            yield Surface(*tube(line, 2.4e-3, 12), HORN)

    def _carried(self) -> dict[str, Array]:
        """In the frame of each horn, the middle of the nodes that move with it, in [m]."""
        simulation = self.simulation
        names = [joint.name for joint in simulation.scene.joints if joint.horn_length > 0.0]
        before = {name: self._seen_from(f"{name}_horn") for name in names}
        simulation.command([0.9 * angle + 0.05 for angle in self.robot.motion(0.0)])
        self._advance(0.5)
        found = {}
        for name in names:
            still = np.linalg.norm(self._seen_from(f"{name}_horn") - before[name], axis=1) < 1e-8
            found[name] = before[name][still].mean(axis=0)
        return found

    def _seen_from(self, frame: str) -> Array:
        pose = self.simulation.frames()[frame]
        return (self.simulation.positions - pose.position) @ rotation_of(pose.quaternion_xyzw)


def _box(
    pose: Pose,
    size: tuple[float, float, float],
    centre: tuple[float, float, float],
    colour: tuple[float, float, float],
) -> Surface:
    surface = surface_of(Shape(box=size))
    return Surface(_placed(surface.points + np.array(centre), pose), surface.triangles, colour)


def _placed(points: Array, pose: Pose) -> Array:
    return pose.position + points @ rotation_of(pose.quaternion_xyzw).T


def clip(robot: Robot, count: int) -> list[Image.Image]:
    """The pictures of a robot, all from one place."""
    frames = list(Shown(robot).frames(count))
    around = np.concatenate([surface.points for frame in frames for surface in frame])
    camera = Camera(around, robot.azimuth, robot.elevation, TILE, floor=float(around[:, 2].min()))
    return [render(frame, camera) for frame in frames]


def together(tiles: Sequence[Image.Image]) -> Image.Image:
    """Two by two, with a gap."""
    width, height = TILE
    image = Image.new("RGB", (2 * width + GAP, 2 * height + GAP), "white")
    for number, tile in enumerate(tiles):
        image.paste(tile, ((number % 2) * (width + GAP), (number // 2) * (height + GAP)))
    return image


def main() -> None:
    """Run each robot, put the pictures side by side, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--still", type=Path)
    still = parser.parse_args().still
    count = 6 if still else FRAMES
    with ProcessPoolExecutor(len(ROBOTS)) as pool:
        clips = list(pool.map(clip, ROBOTS, [count] * len(ROBOTS)))
    images = [together(tiles) for tiles in zip(*clips, strict=True)]
    if still:
        images[3].save(still)
        return
    images[0].save(
        FOLDER / "moving.webp",
        save_all=True,
        append_images=images[1:],
        duration=round(1e3 * PERIOD_S),
        loop=0,
        quality=75,
        method=4,
    )


if __name__ == "__main__":
    main()
