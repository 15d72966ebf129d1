"""The scenes of the reference simulator's results, built from the reference meshes, in our units and frame.

The reference works in mm, kg, s with y up; (x, y, z)_ours = 0.001 (z, x, y)_reference. It loads the silicone
turned by +90 deg about x and shifted by 30 along y: a point of the mesh file goes to 0.001 (y, x, 30 - z).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softsim_core.base import Array, MeshFile, Placement
from softsim_core.physics.mechanics import JointLimits
from softsim_core.robots import WheelSpring, elastic_body, tripod
from softsim_core.scene import (
    CommandSettings,
    RobotDescription,
    Scene,
    SolverSettings,
    StartAnimation,
    load_scene,
)

SILICONE_PLACEMENT = Placement(scale=0.001, rotation_deg=(180.0, 0.0, 90.0), translation=(0.0, 0.0, 0.030))
"""From the frame of the reference's silicone meshes to ours."""

SERVO_STIFFNESS = 1.0e9 * 1.0e-6
"""The reference's 1e9 mN mm/rad, in [N m/rad]."""

SERVO_INERTIA = 0.01 * 1.0e-6
"""The reference's 0.01 kg mm^2, in [kg m^2]."""


def from_reference(points_mm: Array) -> Array:
    """Points or directions (..., 3) of the reference's world, in [mm], in our world, in [m]."""
    return 0.001 * np.asarray(points_mm)[..., [2, 0, 1]]


def quaternion_from_reference(quaternion_xyzw: Array) -> Array:
    """Orientation (..., 4) of a frame of the reference, of which ours is the same body turned with the world.

    The reference's frame axes are permuted with the world's, so a frame at rest there is the identity here.
    """
    return np.asarray(quaternion_xyzw)[..., [2, 0, 1, 3]]


def silicone_mesh(reference_dir: Path, level: str) -> MeshFile:
    """The reference's silicone mesh, level "low", "mid" or "high", placed as in the robot."""
    return MeshFile(
        file=reference_dir / "data" / "tripod" / f"tripod_{level}.gidmsh", placement=SILICONE_PLACEMENT
    )


def held_centre(reference_dir: Path, level: str) -> RobotDescription:
    """Silicone alone, held exactly by the box about (10, 30, 0) of the reference; no damping, qr."""
    mesh = silicone_mesh(reference_dir, level)
    overrides = {"bodies": [{"name": "silicone", "mesh": mesh, "surface": None}]}
    return load_scene("held_centre", overrides)


def full_tripod(reference_dir: Path, level: str) -> RobotDescription:
    """The whole robot with compliant servos without limits; its start animation is the reference's A."""
    scene = Scene(name="reference_tripod", solver=SolverSettings(rotation="qr", rayleigh_stiffness=0.005))
    scene.commands = CommandSettings(enforce_limits=False)
    scene.add(
        tripod(
            silicone=elastic_body("silicone", silicone_mesh(reference_dir, level)).with_bodies(
                mass_distribution="equal"
            ),
            limits=JointLimits(),
            spring=WheelSpring(SERVO_STIFFNESS, SERVO_INERTIA),
        )
    )
    scene.poses = {"start": (-1.4965, -1.4965, -1.4965)}
    scene.start = StartAnimation(pose="start", duration=0.2, base_shift=0.035)
    return scene.describe()
