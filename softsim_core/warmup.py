"""Fill the cache of compiled kernels: `python -m softsim_core.warmup`."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from subprocess import Popen
from time import perf_counter

from softsim_core.actuation.cable import CableDescription
from softsim_core.mesh import box_mesh
from softsim_core.mesh.shapes import Shape
from softsim_core.scene.description import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    SceneDescription,
)
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.objects import CollisionDescription, RigidBodyDescription
from softsim_core.values import Box, Placement

_CONTACT = "from softsim_core.contact.warmup import warm_up_contact; warm_up_contact()"


def small_scene() -> SceneDescription:
    """A small beam with a held end, a joint and a free frame."""
    beam = BodyDescription(
        name="beam",
        mesh=box_mesh((0.04, 0.01, 0.01), (8, 2, 2)),
        material=MaterialDescription(young_modulus=1e5, poisson_ratio=0.3),
        total_mass=0.004,
    )
    size = (0.004, 0.1, 0.1)
    targets = (("held", "world", 0.0), ("driven", "servo", 0.04), ("middle", "free", 0.02))
    return SceneDescription(
        name="warmup",
        bodies=(beam,),
        joints=(JointDescription(name="servo"),),
        attachments=tuple(
            AttachmentDescription(name=name, body="beam", to=to, box=Box(center=(x, 0.0, 0.0), size=size))
            for name, to, x in targets
        ),
        effector="middle",
    )


def touching_scene() -> SceneDescription:
    """The same beam, with a cable in it and a ball on it: with these it runs every kernel."""
    scene = small_scene()
    cable = CableDescription(body="beam", points=((0.01, 0.005, 0.005), (0.03, 0.005, 0.005)))
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.005), mass=0.001, pose=Placement(translation=(0.01, 0.005, 0.0165))
    )
    return replace(
        scene,
        joints=(*scene.joints, JointDescription(name="cable", kind="cable", actuator=cable)),
        rigid_bodies=(ball,),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("beam", "ball")),
    )


def cached_kernels() -> tuple[int, Path]:
    """How many kernels stand compiled in Numba's cache, and in which folder it lies."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(__file__).parent
    return sum(1 for _ in folder.rglob("*.nbc")), folder


def warm_up() -> float:
    """Compile, or load from the cache, every kernel of the fast step; returns the seconds it took."""
    from softsim_core.actuation.compiled.compile import compiler as actuation_compiler
    from softsim_core.contact.compile import compiler as contact_compiler
    from softsim_core.contact.detection.compile import compiler as detection_compiler
    from softsim_core.contact.solver.compile import compiler as contact_solver_compiler
    from softsim_core.contact.warmup import warm_up_contact
    from softsim_core.dynamics.numba_backend.compile import compiler as step_compiler
    from softsim_core.linalg.compile import compiler as linalg_compiler
    from softsim_core.simulation import Simulation

    for compiler in (
        linalg_compiler,
        actuation_compiler,
        step_compiler,
        contact_compiler,
        detection_compiler,
        contact_solver_compiler,
    ):
        compiler.forget_old_kernels()
    started = perf_counter()
    with Popen([sys.executable, "-c", _CONTACT]):  # on a core of its own, into the same cache
        simulation = Simulation(small_scene(), backend="numba")
        simulation.step()
        simulation.von_mises()
        simulation.reduced_stiffness()
    warm_up_contact()
    simulation = Simulation(touching_scene(), backend="numba")
    simulation.step()
    return perf_counter() - started


if __name__ == "__main__":
    sys.stdout.write("compiling the simulation kernels (once, 30 to 120 s) ...\n")
    sys.stdout.flush()
    sys.stdout.write(f"kernels ready after {warm_up():.1f} s\n")
