"""Random drops, stacks, grasps and folds, every step held to the contact law.

`PYTHONPATH=tests:. python tests/analytic/random_contacts.py STEPS [SEED]` prints what was run: steps and
scenes of each kind, the deepest overlap, and how far forces at rest are from the weights.
"""

from __future__ import annotations

import itertools
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from contact_scenes import FLOOR, GRAVITY, touching
from numpy.random import Generator
from small_scenes import body
from surface_gaps import signed_distances

from softsim_core import Simulation
from softsim_core.base import Array, Box, Placement
from softsim_core.physics.contact import crossings, may_meet
from softsim_core.physics.fem import inverted_cells
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import Shape, TetMesh, box_mesh, quadratic
from softsim_core.scene import (
    BodyDescription,
    CollisionDescription,
    RigidBodyDescription,
    SceneDescription,
    load_scene,
)

OVERLAP = 1.0e-4
"""Deepest overlap that is accepted, in [m]: gaps shrink at most by this and the contact distance."""
OFF = 0.02
"""Accepted error of the floor's force on things at rest, as a share of their weight."""
STEPS = 240
"""Number of steps of a scene."""
_LOOKS = 60
"""Steps between two looks by brute force, at whether something has passed."""
_PLANE = RigidBodyDescription(name="floor", shape=Shape(plane=(1.0, 1.0)))


@dataclass
class Count:
    """What was run.

    Attributes:
        steps, scenes: Numbers of each kind.
        deepest: Largest distance by which surfaces came closer than the contact distance, in [m].
        crushed: Number of scenes that ended early because a cell was turned inside out.
        looks: Number of pairs of surfaces that brute force has measured.
        rests: Shares by which forces at rest differ from weights.
    """

    steps: Counter[str] = field(default_factory=Counter)
    scenes: Counter[str] = field(default_factory=Counter)
    deepest: float = 0.0
    crushed: int = 0
    looks: int = 0
    rests: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        kinds = ", ".join(f"{kind} {self.scenes[kind]} ({n} steps)" for kind, n in self.steps.items())
        off = max(self.rests, default=0.0)
        return (
            f"{self.steps.total()} steps: {kinds}; "
            f"{1e3 * self.deepest:.4f} mm closer than the contact distance at most; "
            f"{self.crushed} crushed; {self.looks} pairs measured by brute force; "
            f"{len(self.rests)} at rest, forces within {off:.2g}"
        )


def turned(random: Generator, mesh: TetMesh, lowest: float) -> TetMesh:
    """The mesh in a random orientation, its lowest point at the height `lowest` [m]."""
    points = mesh.points @ rotation_exp(random.normal(size=3)).T
    points[:, 2] += lowest - points[:, 2].min()
    points[:, :2] += random.uniform(-0.004, 0.004, 2)
    return replace(mesh, points=points)


def soft_block(random: Generator, name: str, lowest: float) -> BodyDescription:
    """A block or a slender rod of tetrahedra, linear or quadratic, or of hexahedra."""
    slender = random.random() < 0.2
    size = (0.12, 0.008, 0.008) if slender else tuple(random.uniform(0.02, 0.04, 3).tolist())
    cells = (10, 1, 1) if slender else tuple(random.integers(2, 4, 3).tolist())
    hexahedra = random.random() < 0.25
    mesh = box_mesh(size, cells, tuple(-0.5 * each for each in size), name, hexahedra=hexahedra)
    if not hexahedra and random.random() < 0.2:
        mesh = quadratic(mesh)
    stiff = 10.0 ** random.uniform(4.3, 5.5)
    return body(
        turned(random, mesh, lowest), name, stiff, random.uniform(0.2, 0.47), random.uniform(0.02, 0.1)
    )


def rigid_thing(random: Generator, name: str, lowest: float) -> RigidBodyDescription:
    """A box, a cylinder or a sphere."""
    radius, height = random.uniform(0.008, 0.02, 2).tolist()
    shapes = (
        Shape(box=tuple(random.uniform(0.01, 0.04, 3).tolist())),
        Shape(cylinder=(radius, 2.0 * height)),
        Shape(sphere=radius),
    )
    spot = (*random.uniform(-0.004, 0.004, 2).tolist(), lowest + 0.035)
    pose = Placement(translation=spot, rotation_deg=tuple(random.uniform(-180.0, 180.0, 3).tolist()))
    shape = shapes[random.integers(len(shapes))]
    return RigidBodyDescription(name=name, shape=shape, mass=random.uniform(0.02, 0.1), pose=pose)


def drop(random: Generator) -> SceneDescription:
    """One to three things that fall on the floor and on each other."""
    soft, rigid, lowest = [], [], random.uniform(0.005, 0.3)
    for k in range(random.integers(1, 4)):
        if random.random() < 0.6:
            soft.append(soft_block(random, f"soft{k}", lowest))
        else:
            rigid.append(rigid_thing(random, f"rigid{k}", lowest))
        lowest += 0.13
    floor = FLOOR if random.random() < 0.5 else _PLANE
    return touching(
        floor, *rigid, soft=tuple(soft), friction=random.uniform(0.0, 1.0),
        dt=float(random.choice([0.005, 0.01, 0.02])), rayleigh_stiffness=random.uniform(0.0, 0.02),
    )  # fmt: skip


def stack(random: Generator) -> SceneDescription:
    """Boxes on each other, one of them soft."""
    middle = int(random.integers(3))
    soft: tuple[BodyDescription, ...] = ()
    rigid = []
    for k in range(3):
        low = 0.002 + 0.022 * k
        if k == middle:
            mesh = box_mesh((0.04, 0.04, 0.02), (3, 3, 2), (-0.02, -0.02, low))
            soft = (body(mesh, "soft", 10.0 ** random.uniform(4.7, 5.5), 0.4, random.uniform(0.02, 0.06)),)
            continue
        spot = (*random.uniform(-0.004, 0.004, 2).tolist(), low + 0.01)
        pose = Placement(translation=spot, rotation_deg=(0.0, 0.0, random.uniform(-45.0, 45.0)))
        shape = Shape(box=(0.04, 0.04, 0.02))
        rigid.append(
            RigidBodyDescription(name=f"box{k}", shape=shape, mass=random.uniform(0.02, 0.06), pose=pose)
        )
    return touching(FLOOR, *rigid, soft=soft, friction=random.uniform(0.3, 1.0), rayleigh_stiffness=0.02)


def fold(random: Generator) -> SceneDescription:
    """A soft bracket on the floor whose upper arm is pressed onto its lower one by what falls on it."""
    whole = box_mesh((0.06, 0.02, 0.024), (9, 2, 4), (-0.03, -0.01, 0.002))
    centre = whole.points[whole.tets].mean(axis=1)
    open_there = (centre[:, 0] > -0.015) & (np.abs(centre[:, 2] - 0.014) < 0.006)
    used, tets = np.unique(whole.tets[~open_there], return_inverse=True)
    mesh = TetMesh(whole.points[used], tets.reshape(-1, 4))
    bracket = body(mesh, "bracket", 10.0 ** random.uniform(4.3, 5.0), 0.4, 0.03)
    weight = replace(rigid_thing(random, "weight", 0.03), mass=random.uniform(0.05, 0.3))
    scene = touching(
        FLOOR, weight, soft=(bracket,), friction=random.uniform(0.0, 1.0), rayleigh_stiffness=0.01
    )
    arms = []
    for name, x, z, groups in (
        ("lower", 0.01, 0.008, ("lower",)),
        ("upper", 0.01, 0.020, ("upper",)),
        ("back", -0.0225, 0.014, ("lower", "upper")),
    ):
        arm = Box(center=(x, 0.0, z), size=(0.0498, 0.03, 0.0122) if x > 0.0 else (0.0152, 0.03, 0.03))
        arms.append(CollisionDescription(name=name, body="bracket", groups=groups, boxes=(arm,)))
    others = [each for each in scene.collisions if each.body != "bracket"]
    return replace(scene, collisions=(*arms, *others))


def grasp(random: Generator) -> SceneDescription:
    """The gripper with three fingers over its cube."""
    return load_scene("cable_gripper", {"contact": {"friction": random.uniform(0.2, 1.0)}}).scene


KINDS: dict[str, Callable[[Generator], SceneDescription]] = {
    "drop": drop, "stack": stack, "fold": fold, "grasp": grasp,
}  # fmt: skip


def hold(kind: str, seed: int, count: Count, steps: int = STEPS) -> None:
    """Run a random scene; add to `count`.

    Raises:
        AssertionError: something has passed, overlaps too much, or does not weigh what it should.
    """
    random = np.random.default_rng([seed, *kind.encode()])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        sim = Simulation(KINDS[kind](random))
    count.scenes[kind] += 1
    apart = sim.contact_limits.contact_distance
    for step in range(steps):
        if kind == "grasp":
            sim.command(gripper_command(random, sim, step / steps))
        sim.step()
        count.steps[kind] += 1
        closer = -float(sim.contacts.gaps.min(initial=0.0))
        count.deepest = max(count.deepest, closer)
        assert closer <= apart + OVERLAP, f"{kind} {seed}, step {step}: {1e3 * closer:.3f} mm too close"
        if any(inverted_cells(group, sim.positions).any() for group in sim.model.groups):
            count.crushed += 1  # a surface that has passed through its own body is no matter of contact
            return
        if step % _LOOKS == _LOOKS - 1:
            look(sim, count, f"{kind} {seed}, step {step}")
    if kind in ("drop", "stack"):
        weigh(sim, count, f"{kind} {seed}")


def gripper_command(random: Generator, sim: Simulation, share: float) -> Array:
    """Go down and close, with noise."""
    command = sim.joint_targets.copy()
    for j, joint in enumerate(sim.model.joints):
        aim = 0.012 * share if not joint.moves_frame else (-0.05 if joint.name == "vertical" else 0.0)
        command[j] += 0.1 * (aim - command[j]) + random.normal(scale=2e-4)
        if not joint.moves_frame:
            command[j] = max(command[j], 0.0)
    return command


def look(sim: Simulation, count: Count, where: str) -> None:
    """Measure by brute force that nothing has passed: no vertex is inside, no surfaces cross."""
    surfaces, points = sim.collision_surfaces, sim.collision_points
    for a, b in itertools.permutations(surfaces, 2):
        if a.radius or b.radius or not b.closed or not may_meet(a, b):
            continue
        corners, near = points[b.triangles], points[a.vertices]
        within = (near > corners.min(axis=(0, 1))) & (near < corners.max(axis=(0, 1)))
        inside = near[within.all(axis=1)]
        count.looks += 1
        if len(inside):
            deepest = signed_distances(inside, corners, closed=True).min()
            assert deepest > -OVERLAP, f"{where}: {a.name} in {b.name}, {1e3 * deepest:.3f} mm"
    triangles = np.concatenate([each.triangles for each in surfaces])
    number = np.repeat(np.arange(len(surfaces)), [len(each.triangles) for each in surfaces])
    for i, j in number[crossings(points[triangles], triangles)]:
        assert not may_meet(surfaces[i], surfaces[j]), (
            f"{where}: {surfaces[i].name} crosses {surfaces[j].name}"
        )


def weigh(sim: Simulation, count: Count, where: str) -> None:
    """Compare the floor's force with the weight, if all is at rest on it."""
    speed = max(np.abs(sim.velocities).max(initial=0.0), np.abs(sim.rigid_velocities[:, :3]).max(initial=0.0))
    heights = [pose.position[2] for pose in sim.rigid_poses]
    if speed > 1e-3 or min(heights, default=0.1) < 0.0:
        return
    contacts, floor = sim.contacts, sim.contacts.body_names.index("floor")
    sign = (contacts.bodies[:, 1] == floor) * 1.0 - (contacts.bodies[:, 0] == floor)
    bears = float(sign @ contacts.forces[:, 2])
    mass = sim.model.mass.sum() + sim.model.rigid.mass.sum()
    off = abs(bears / (mass * GRAVITY) - 1.0)
    count.rests.append(off)
    assert off < OFF, f"{where}: the floor bears {bears:.4f} N of {mass * GRAVITY:.4f} N"


def main(steps: int, seed: int) -> int:
    """Run scenes of all kinds in turn until `steps` are done; return the number of failures."""
    count, failures = Count(), 0
    while count.steps.total() < steps:
        for kind in KINDS:
            try:
                hold(kind, seed, count)
            except AssertionError as error:
                failures += 1
                print(f"FAILED {error}", flush=True)
        if seed % 10 == 0:
            print(count, flush=True)
        seed += 1
    print(f"{failures} failed; {count}", flush=True)
    return failures


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0) > 0)
