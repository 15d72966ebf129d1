"""A trunk that hangs from its base: three segments of vacuum hose, six motors that pull antagonistic pairs.

Lengths and directions are measured (trunk-stack of the Stanford ASL). Stiffness, radii and masses are
assumed, such that each motor moves tip and first disk as far per degree as measured, within 20 %.
"""

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
from softsim_core.robots import bend_keys

SEGMENTS = (  # base, middle and tip: directions of the motors 3 and 5, 1 and 6, 2 and 4 in [deg]
    TendonSegment(0.106, (175.0, -111.0), disks=5, radius=0.02),
    TendonSegment(0.095, (47.0, -43.0), disks=5, radius=0.02),
    TendonSegment(0.115, (107.0, -163.0), disks=5, radius=0.02),
)


def create_scene(scene: Scene) -> None:
    """Six motors with pulleys of 22.5 mm, and a gripper at the tip."""
    scene.solver = SolverSettings(rayleigh_stiffness=0.02)
    hose = (2000.0, 1000.0, 1000.0, 0.07, 0.07, 0.05)  # N and N m^2
    scene.add(
        tendon_arm(
            SEGMENTS,
            Backbone(diameter=0.03, young_modulus=1.0e6, wall=0.002, density=300.0, stiffness=hose),
            Tendon(compliance=4.5e-4, pull_only=False),
            limits=JointLimits(lower=-0.04, upper=0.04, speed=0.10, acceleration=1.0),
            disk_mass=0.01,
            tip_load=0.1,
        )
    )
    scene.poses = {"start": (0.0,) * 6}
    scene.view = ViewSettings(tensions=True)
    scene.keys = {
        **bend_keys(SEGMENTS),
        "a": KeyBinding(pose="start", help="straight"),
        "b": KeyBinding(action="send", help="send to the motors"),
        "i": KeyBinding(action="inverse", help="inverse control"),
    }
    scene.inverse = InverseSettings(rate=5.0, max_shift=0.01, tolerance=3.0e-4)
    servos = (
        BusServo(joint=joint.name, id=number, travel=0.0225)
        for joint, number in zip(scene.joints, (3, 5, 1, 6, 2, 4), strict=True)
    )
    scene.board = BoardDescription(servos=tuple(servos), baud_rate=1000000)
