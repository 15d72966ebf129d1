"""The maze on a plate of its own: it rises by 20 mm, then tilts about x and y as the plan says.

The plan runs from the start: edit configs/paths/tripod_maze.json, reload, and see where the ball goes. The
plate rides on two hinges on a slide; R = Rx(tilt_x) Ry(tilt_y), as the path follower has it.
"""

from pathlib import Path

from softsim_core import (
    CollisionDescription,
    ContactSettings,
    Controller,
    JointDescription,
    JointLimits,
    MeshFile,
    Placement,
    RigidBodyDescription,
    Scene,
    Shape,
    Simulation,
    read_path,
    rotation_of,
    tilts_of,
)

PLAN = Path(__file__).resolve().parents[1] / "paths" / "tripod_maze.json"
CENTRE = Placement(translation=(0.0, 0.0, 0.040))


def create_scene(scene: Scene) -> None:
    """A slide, two hinges, the maze on them, a ball in it, and the plan."""
    limits = JointLimits(lower=-0.4, upper=0.4)
    scene.add(JointDescription(name="lift", kind="prismatic", axis=(0.0, 0.0, 1.0)))
    scene.add(
        JointDescription(name="tilt_x", parent="lift", base=CENTRE, axis=(1.0, 0.0, 0.0), limits=limits)
    )
    scene.add(
        JointDescription(name="tilt_y", parent="tilt_x", base=CENTRE, axis=(0.0, 1.0, 0.0), limits=limits)
    )
    maze = Shape(mesh=MeshFile(file=Path("../meshes/maze.stl")))
    scene.add(RigidBodyDescription(name="maze", shape=maze, on="tilt_y", colour=(0.3, 0.5, 0.9, 1.0)))
    start = Placement(translation=(-0.0252857, -0.0252857, 0.0426))
    scene.add(
        RigidBodyDescription(
            name="ball", shape=Shape(sphere=0.002), mass=1.0e-4, pose=start, colour=(0.9, 0.2, 0.1, 1.0)
        )
    )
    scene.add([CollisionDescription(name=name, body=name) for name in ("maze", "ball")])
    scene.contact = ContactSettings(alarm_distance=0.004, contact_distance=0.0005, friction=0.0)

    path = read_path(PLAN, CENTRE.translation)

    def follow(simulation: Simulation) -> None:
        goal = path.sample(simulation.time)
        tilts = tilts_of(rotation_of(goal.quaternion_xyzw))
        simulation.command([goal.position[2] - CENTRE.translation[2], tilts[0], tilts[1]])

    scene.add(Controller(on_begin=follow))
