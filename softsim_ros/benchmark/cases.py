"""The scenes that are measured, each on our meshes and on the reference's where they are found."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from softsim_core.scene import load_scene
from softsim_core.scene.files import config_file
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.solver_settings import RotationLaw
from softsim_core.values import MeshFile, Placement
from softsim_ros.benchmark import touching

LEVELS = ("low", "mid", "high")
REFERENCE = "reference_"
MESHES = (*LEVELS, *(REFERENCE + level for level in LEVELS))
SCENES = ("held_centre", "tripod", "inverse", *touching.SCENES)
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
    """Folder of the reference data: $SOFTSIM_REFERENCE, else ../shared/reference beside a checkout."""
    named = os.environ.get("SOFTSIM_REFERENCE")
    return Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "reference"


def reference_mesh(folder: Path, level: str) -> Path:
    """File of a reference mesh below the reference folder; it need not exist."""
    return folder / "data" / "tripod" / f"tripod_{level}.gidmsh"


def silicone(mesh: str, reference: Path) -> MeshFile:
    """The mesh called `mesh`, where it sits in the robot."""
    if mesh.startswith(REFERENCE):
        return MeshFile(
            file=reference_mesh(reference, mesh.removeprefix(REFERENCE)), placement=REFERENCE_PLACEMENT
        )
    return MeshFile(file=config_file(f"meshes/tripod_{mesh}.vtk"), placement=OUR_PLACEMENT)


def describe(scene: str, mesh: str, reference: Path) -> RobotDescription:
    """A benchmark scene: held_centre, the tripod (again for inverse control), or one with cables and contact.

    Our meshes run with the robot's own rotation law (polar), the reference's with the reference's (qr); both
    scenes of a mesh share the law.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    if scene in touching.SCENES:
        if not mesh.startswith(REFERENCE):
            return touching.describe_touching(scene)
        return touching.describe_touching(
            scene, silicone(mesh, reference), touching.reference_finger(reference)
        )
    law: RotationLaw = "qr" if mesh.startswith(REFERENCE) else "polar"
    body = {"name": "silicone", "mesh": silicone(mesh, reference), "surface": None}
    named = "tripod" if scene == "inverse" else scene
    return load_scene(named, {"bodies": [body], "solver": {"rotation": law}})


def available_meshes(reference: Path) -> list[str]:
    """Names of the meshes that are there: ours always."""
    return [
        mesh
        for mesh in MESHES
        if not mesh.startswith(REFERENCE) or reference_mesh(reference, mesh.removeprefix(REFERENCE)).is_file()
    ]


def cases(meshes: Iterable[str], scenes: Iterable[str], reference: Path) -> Iterator[list[Case]]:
    """The cases of each mesh in turn, those of one mesh together; what touches on low meshes only.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    chosen = tuple(scenes)
    for mesh in meshes:
        group = [scene for scene in chosen if mesh in TOUCHING_MESHES or scene not in touching.SCENES]
        if group:
            yield [Case(scene, mesh, describe(scene, mesh, reference)) for scene in group]
