"""Fill the cache of compiled kernels: `python -m softsim_core.simulation.warmup`."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from subprocess import Popen
from threading import Thread
from time import perf_counter, sleep

from softsim_core.base import (
    Box,
    Placement,
    SolverDivergedError,
    python_command,
    start_process,
    use_safe_path,
)
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.kernels import Compiler, alone, compile_process, why_plain
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    RobotDescription,
    SceneDescription,
)

_NICE = 10
"""Niceness of a process that compiles beside a simulation."""

_LOOK_S = 0.2

_CELLS = (8, 2, 2)
_MANY_CELLS = (26, 13, 13)
"""Cells of a beam whose factorisation exceeds `divided_factor.WORTHWHILE`, so that threads share it."""


def small_scene(cells: tuple[int, int, int] = _CELLS) -> SceneDescription:
    """Return a scene of a small beam with a fixed end, a joint and a free frame."""
    beam = BodyDescription(
        name="beam",
        mesh=box_mesh((0.04, 0.01, 0.01), cells),
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


def touching_scene(cells: tuple[int, int, int] = _CELLS) -> SceneDescription:
    """Return the same beam with a cable in it and a ball on it: it runs every kernel of small meshes."""
    scene = small_scene(cells)
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
    """Return the number of compiled kernels in Numba's cache, and its folder."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(__file__).parents[1]
    return sum(1 for _ in folder.rglob("*.nbc")), folder


def kernels_ready() -> bool:
    """Return whether `warm_up` completed with these sources on this processor, or nothing is compiled."""
    mark = _mark()
    return mark is None or mark.is_file()


def get_ready_to_load() -> None:
    """Load everything that a compiled step needs except kernels, for which steps would wait 0.3 s."""
    if _mark() is None:
        return
    from softsim_core.physics.dynamics.numba_backend import stepper  # noqa: F401
    from softsim_core.physics.kernels import get_ready_to_load

    get_ready_to_load()


def warm_up() -> float:
    """Compile, or load from the cache, every kernel of the fast step; return the seconds it took.

    If several processes run it at once, one compiles and the others wait.
    """
    from softsim_core.simulation import Simulation

    mark = _mark()
    if mark is None:
        return 0.0
    started = perf_counter()
    mark.parent.mkdir(parents=True, exist_ok=True)
    with alone(mark.with_name("compiling")):
        for compiler in _compilers():
            compiler.forget_old_kernels()
        if not mark.is_file():
            with _compiling_contact():
                simulation = Simulation(small_scene(), backend="numba")
                simulation.step()
                simulation.von_mises()
                simulation.reduced_stiffness()
            _warm_up_contact()
            Simulation(touching_scene(), backend="numba").step()
            mark.touch()
    return perf_counter() - started


def warm_up_scene(robot: RobotDescription) -> None:
    """Compile, or load from the cache, the kernels of this robot's steps: a fraction of all kernels.

    A process that runs it may switch to the compiled step when this is done.
    """
    from softsim_core.simulation import Simulation

    mark = _mark()
    if mark is None:
        return
    mark.parent.mkdir(parents=True, exist_ok=True)
    with alone(mark.with_name("compiling")):
        for compiler in _compilers():
            compiler.forget_old_kernels()
        with _compiling_contact() if robot.scene.collisions else nullcontext():
            simulation = Simulation(replace(robot, controllers=()), backend="numba")
            with suppress(SolverDivergedError):
                simulation.step()
            simulation.von_mises()
        if robot.scene.collisions:
            _warm_up_contact()


def warm_up_large() -> float:
    """Compile the kernels of large meshes, after all others: threaded factors and conjugate gradients.

    Returns:
        The seconds it took.
    """
    from softsim_core.simulation import Simulation

    started = perf_counter()
    warm_up()
    mark = _mark(kind="large")
    if mark is None:
        return 0.0
    with alone(mark.with_name("compiling-large")):
        if not mark.is_file():
            scene = touching_scene(_MANY_CELLS)
            for linear_solver in ("supernodal", "iterative"):
                solver = replace(scene.solver, linear_solver=linear_solver, threads=2)
                Simulation(replace(scene, solver=solver), backend="numba").step()
            mark.touch()
    return perf_counter() - started


def _compiling_contact() -> Popen[bytes]:
    """Start a process that compiles the contact kernels on a core of its own; its context waits for it."""
    words = ["--contact", "--parent", str(os.getpid())]  # the parent may end before the child can ask for it
    return start_process(python_command("softsim_core.simulation.warmup", *words))


def _warm_up_contact() -> None:
    """Run every contact kernel once on two triangles and two spheres that touch."""
    import numpy as np

    from softsim_core.physics.contact import CollisionSurface, ContactSettings
    from softsim_core.physics.contact.detection import Closeness, Detector, measured_gaps
    from softsim_core.physics.contact.solver import solve_contacts

    points = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [0.2, 0.2, 2], [0.2, 0.2, 4]]
    ).astype(np.float64)
    low = CollisionSurface(name="low", vertices=slice(0, 3), triangles=np.array([[0, 1, 2]]), owner=0)
    high = CollisionSurface(name="high", vertices=slice(3, 6), triangles=np.array([[3, 4, 5]]), owner=1)
    balls = tuple(
        CollisionSurface(name="ball", vertices=slice(6 + k, 7 + k), owner=2 + k, radius=0.9) for k in range(2)
    )
    detector = Detector((low, high, *balls), points, ContactSettings().limits())
    near = detector.detect(points, 1.5)
    detector.again(near.key, points)
    detector.free_share(points, points, np.ones(len(detector.pairs), dtype=np.bool_))
    nothing = near.select(np.zeros(len(near.key), dtype=np.bool_))
    measured_gaps(near, nothing, points, np.zeros(len(points)), 1.5)
    detector.may_hold(near, near.key, points, points, points, Closeness(0.4, 0.1, 0.1, 1e-5), True, True)
    detector.any_astray(near, np.ones((len(near.key), 3)), points, points, 1e-5)
    rows = 1 + 3 * len(near.key)
    solve_contacts(
        np.eye(rows), np.full(rows, -1.0), (np.zeros(1), np.ones(1)), 0.5, np.zeros(rows), 10, 1e-9
    )


def _compilers() -> tuple[Compiler, ...]:
    from softsim_core.physics.actuation.compiled import compiler as actuation
    from softsim_core.physics.contact import compiler as contact
    from softsim_core.physics.dynamics.numba_backend import compiler as step
    from softsim_core.physics.linalg import compiler as linalg

    return (step, linalg, actuation, contact)


def _mark(kind: str = "ready") -> Path | None:
    """Return the file that marks cached kernels, in the folder of the step's; None: none is compiled.

    Args:
        kind: "ready": kernels of every robot's step; "large": those of large meshes.
    """
    compilers = _compilers()
    folder = compilers[0].cache
    if folder is None:
        return None
    import numba

    from softsim_core.physics.linalg import host_processor

    versions = [*(each.name for each in compilers), numba.__version__, sys.version, *host_processor()]
    return folder / f"{kind}-{hashlib.sha256(repr(versions).encode()).hexdigest()[:16]}"


def _end_with_parent(parent: int) -> None:
    """End this process when the given parent has ended; compiling does not react to signals for seconds."""

    def watch() -> None:
        while os.getppid() == parent:
            sleep(_LOOK_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def main(words: Sequence[str] | None = None) -> int:
    """Compile the kernels; `--beside` does it at low priority and ends with the process that started it."""
    parser = argparse.ArgumentParser(prog="python -m softsim_core.simulation.warmup", description=__doc__)
    parser.add_argument("--beside", action="store_true", help="at low priority, ending with the parent")
    parser.add_argument("--contact", action="store_true", help="the kernels of contact alone")
    parser.add_argument("--scene", help="those of this scene or robot, too")
    parser.add_argument("--only", action="store_true", help="those of the scene, and no others")
    parser.add_argument("--small", action="store_true", help="none of large meshes")
    parser.add_argument("--parent", type=int, default=os.getppid(), help="the process to end with")
    chosen = parser.parse_args(words)
    use_safe_path()
    compile_process.compile_here()
    if chosen.beside or chosen.contact:
        _end_with_parent(chosen.parent)
        if why_plain() is None:
            from softsim_core.physics.kernels import be_silent

            be_silent()
    if chosen.beside and hasattr(os, "nice"):
        os.nice(_NICE)
    if chosen.contact:
        _warm_up_contact()
        return 0
    sys.stdout.write("compiling the simulation kernels (once, 30 to 120 s) ...\n")
    sys.stdout.flush()
    started = perf_counter()
    if not chosen.only:
        warm_up()
    if chosen.scene:
        from softsim_core.scene import load_scene

        warm_up_scene(load_scene(chosen.scene))
    if not chosen.only and not chosen.small:
        warm_up_large()
    sys.stdout.write(f"kernels ready after {perf_counter() - started:.1f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
