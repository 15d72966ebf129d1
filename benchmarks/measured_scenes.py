"""Scenes of the step benchmark, including those with cables and contact."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core import Simulation
from softsim_core.base import Array, Backend, MeshFile, Placement
from softsim_core.scene import BodyDescription, RobotDescription, RotationLaw, load_scene
from softsim_core.scene.io import config_file

TOUCHING = ("cable_finger", "gripper_free", "gripper_grasp", "tripod_ball")
LIMITS = {"cable_finger": 0.2, "gripper_free": 0.8, "gripper_grasp": 2.5, "tripod_ball": 1.2}
"""Longest step in [ms] on a machine where the clamped body of the low mesh takes CLAMPED_MS."""
CLAMPED_MS = 0.17

CLOSED, LOWERED = 0.012, -0.050
"""Pull of the cables and height of the grasping gripper in [m]."""
LEAD_IN = {"cable_finger": 60, "gripper_free": 60, "gripper_grasp": 350, "tripod_ball": 150}
"""Steps to the state in which a scene is measured: the gripper has closed, the ball has come to rest."""


_FINGER_TURNS = {
    "finger": (90.0, 0.0, 90.0),
    "finger_1": (-90.0, -75.0, -90.0),
    "finger_2": (-90.0, -65.0, 90.0),
    "finger_3": (-90.0, -65.0, 90.0),
}
"""Rotation in [deg] from the reference's finger mesh, which has its axes in another order, to ours."""


def reference_finger(folder: Path) -> Path:
    """Return the file of the reference's finger mesh below the reference folder; it may not exist."""
    return folder / "data" / "cable_gripper" / "finger.vtk"


def describe_touching(
    scene: str, silicone: MeshFile | None = None, finger: Path | None = None
) -> RobotDescription:
    """Return one of the scenes TOUCHING.

    Args:
        scene: Its name.
        silicone: The Tripod's mesh, placed in the robot; None: our low mesh.
        finger: The reference's finger mesh; None: our low mesh.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    named = "cable_gripper" if scene.startswith("gripper") else scene
    overrides: dict[str, Any] = {"collisions": [], "rigid_bodies": []} if scene == "gripper_free" else {}
    if scene == "tripod_ball" and silicone is not None:
        overrides["bodies"] = [{"name": "silicone", "mesh": silicone, "surface": None}]
        overrides["solver"] = {"rotation": "qr"}
    elif scene != "tripod_ball" and finger is not None:
        overrides["bodies"] = [_on_reference_mesh(body, finger) for body in load_scene(named).scene.bodies]
        overrides["solver"] = {"rotation": "qr"}
    return load_scene(named, overrides)


def _on_reference_mesh(body: BodyDescription, finger: Path) -> dict[str, Any]:
    """Return the overrides that give a finger the reference's mesh, in the same place."""
    ours = body.mesh.placement if isinstance(body.mesh, MeshFile) else None
    translation = ours.translation if ours is not None else (0.0, 0.0, 0.0)
    placement = Placement(scale=0.001, rotation_deg=_FINGER_TURNS[body.name], translation=translation)
    return {"name": body.name, "mesh": MeshFile(file=finger, placement=placement), "surface": None}


class TouchingScene:
    """A simulation that restarts from a state with pulled cables and contact.

    Args:
        name: One of TOUCHING.
        description: The scene.
        backend: Implementation of the step that is measured.
    """

    def __init__(self, name: str, description: RobotDescription, backend: Backend) -> None:
        with warnings.catch_warnings():  # the warnings about slivers are known
            warnings.simplefilter("ignore", UserWarning)
            leader, self.simulation = Simulation(description), Simulation(description, backend)
        if description.start is not None:
            leader.start_animation()
        for step in range(LEAD_IN[name]):
            if description.start is None:
                leader.command(_compute_command(leader, name, step / LEAD_IN[name]))
            leader.step()
        self._home, self._command = leader.snapshot(), leader.joint_targets
        self._random = np.random.default_rng(1)
        self.stir()

    def stir(self) -> None:
        """Restore the initial state, and command a nearby position."""
        self.simulation.restore(self._home)
        size = 0.02 if self.simulation.robot.start is not None else 1e-3  # in rad and in m
        self.simulation.command(self._command + self._random.uniform(-size, size, len(self._command)))


def _compute_command(simulation: Simulation, name: str, share: float) -> Array:
    """Return the command at a fraction of the lead-in: first down if there is a cube, then closed."""
    down = 0.4 if name == "gripper_grasp" else 0.0
    cables = [not joint.moves_frame for joint in simulation.model.joints]
    command = np.where(cables, CLOSED * max(0.0, (share - down) / (1.0 - down)), 0.0)
    if down:
        command[simulation.joint_names.index("vertical")] = LOWERED * min(1.0, share / down)
    return command


LEVELS = ("low", "mid", "high")
REFERENCE = "reference_"
MESHES = (*LEVELS, *(REFERENCE + level for level in LEVELS))
SCENES = ("held_centre", "tripod", "inverse", *TOUCHING)
TOUCHING_MESHES = ("low", REFERENCE + "low")
"""Meshes on which scenes with cables and contact are measured."""

OUR_PLACEMENT = Placement(translation=(0.0, 0.0, 0.025))
REFERENCE_PLACEMENT = Placement(scale=0.001, rotation_deg=(180.0, 0.0, 90.0), translation=(0.0, 0.0, 0.030))
"""From the millimetres and the y-up frame of the reference's silicone meshes to ours."""


@dataclass(frozen=True)
class Case:
    """A scene on a mesh: names as in Record, and the description to simulate."""

    scene: str
    mesh: str
    description: RobotDescription


def default_reference_dir() -> Path:
    """Return the folder of the reference data.

    It is $SOFTSIM_REFERENCE, else ../shared/reference beside a checkout.
    """
    named = os.environ.get("SOFTSIM_REFERENCE")
    return Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "reference"


def reference_mesh(folder: Path, level: str) -> Path:
    """Return the file of a reference mesh below the reference folder; it may not exist."""
    return folder / "data" / "tripod" / f"tripod_{level}.gidmsh"


def silicone(mesh: str, reference: Path) -> MeshFile:
    """Return the mesh called `mesh`, placed in the robot."""
    if mesh.startswith(REFERENCE):
        return MeshFile(
            file=reference_mesh(reference, mesh.removeprefix(REFERENCE)), placement=REFERENCE_PLACEMENT
        )
    return MeshFile(file=config_file(f"meshes/tripod_{mesh}.vtk"), placement=OUR_PLACEMENT)


def describe(scene: str, mesh: str, reference: Path) -> RobotDescription:
    """Return a benchmark scene: held_centre, the Tripod (also for inverse control), or one of TOUCHING.

    Our meshes run with the robot's own rotation law (polar), the reference's with the reference's (qr); both
    scenes of a mesh share the law.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    if scene in TOUCHING:
        if not mesh.startswith(REFERENCE):
            return describe_touching(scene)
        return describe_touching(scene, silicone(mesh, reference), reference_finger(reference))
    law: RotationLaw = "qr" if mesh.startswith(REFERENCE) else "polar"
    body = {"name": "silicone", "mesh": silicone(mesh, reference), "surface": None}
    named = "tripod" if scene == "inverse" else scene
    return load_scene(named, {"bodies": [body], "solver": {"rotation": law}})


def available_meshes(reference: Path) -> list[str]:
    """Return the names of the meshes that exist; ours always do."""
    return [
        mesh
        for mesh in MESHES
        if not mesh.startswith(REFERENCE) or reference_mesh(reference, mesh.removeprefix(REFERENCE)).is_file()
    ]


def cases(meshes: Iterable[str], scenes: Iterable[str], reference: Path) -> Iterator[list[Case]]:
    """Yield the cases of each mesh as one list; scenes with contact on low meshes only.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    chosen = tuple(scenes)
    for mesh in meshes:
        group = [scene for scene in chosen if mesh in TOUCHING_MESHES or scene not in TOUCHING]
        if group:
            yield [Case(scene, mesh, describe(scene, mesh, reference)) for scene in group]
