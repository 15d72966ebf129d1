"""A tendon arm that hangs from its base: three segments on a rod of nickel-titanium, nine motors.

The tendons are wires of steel with a spring at each motor. Tendon T of segment K, both numbered from 0, is
the joint sKtT; the frame at the end of segment K is arm_K.
"""

import numpy as np

from softsim_core import (
    Backbone,
    BoardDescription,
    BusServo,
    InverseSettings,
    JointLimits,
    KeyBinding,
    Scene,
    SolverSettings,
    Tendon,
    TendonSegment,
    ViewSettings,
    tendon_arm,
)
from softsim_core.robots import bend_keys, bending_commands

SEGMENTS = tuple(TendonSegment(0.08, (angle, angle + 120.0, angle + 240.0)) for angle in (0.0, 40.0, 80.0))

BENDS = {
    "start": np.zeros((3, 2)),
    "hook": np.full((3, 2), [0.7, 0.0]),
    "s": np.array([[0.8, 0], [-0.8, 0], [-0.5, 0]]),
}
"""Poses, as the bend of each segment towards x and y in [rad]."""


def create_scene(scene: Scene) -> None:
    """Nine motors wind the tendons on drums of 10 mm."""
    scene.solver = SolverSettings(rayleigh_stiffness=0.005)
    scene.add(
        tendon_arm(
            SEGMENTS,
            Backbone(diameter=0.0012, young_modulus=60.0e9, density=6450.0),
            Tendon(axial_stiffness=2000.0, compliance=2.0e-4, pretension=3.0, max_tension=40.0),
            limits=JointLimits(lower=-0.03, upper=0.03, speed=0.04, acceleration=0.4),
            disk_mass=0.002,
        )
    )
    scene.poses = {name: tuple(bending_commands(SEGMENTS, bends).tolist()) for name, bends in BENDS.items()}
    scene.view = ViewSettings(tensions=True)
    scene.keys = {
        **bend_keys(SEGMENTS),
        "a": KeyBinding(pose="start", help="straight"),
        "q": KeyBinding(pose="hook", help="hook"),
        "z": KeyBinding(pose="s", help="S"),
        "b": KeyBinding(action="send", help="send to the motors"),
        "i": KeyBinding(action="inverse", help="inverse control"),
    }
    scene.inverse = InverseSettings(
        rate=5.0, max_shift=0.005, min_tension=1.5, torque_limit=32.0, tolerance=3.0e-4, retry=True
    )
    servos = (BusServo(joint=joint.name, id=k, travel=0.010) for k, joint in enumerate(scene.joints))
    scene.board = BoardDescription(servos=tuple(servos), baud_rate=1000000)
