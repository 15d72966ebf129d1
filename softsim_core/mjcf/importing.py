"""From a MuJoCo model to a scene of ours: a description, the meshes it names, and what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softsim_core.errors import MeshError, MjcfError, SceneError
from softsim_core.mesh.types import SurfaceMesh
from softsim_core.mjcf.carriers import carriers, vector
from softsim_core.mjcf.flexes import SoftBody, soft_bodies
from softsim_core.mjcf.geoms import rigid_bodies
from softsim_core.mjcf.reading import Loaded, Names, load_model
from softsim_core.mjcf.remaining import remaining
from softsim_core.mjcf.tendons import cables
from softsim_core.mjcf.touching import collisions
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.solver_settings import SolverSettings


@dataclass(frozen=True, slots=True, eq=False)
class ImportedScene:
    """A MuJoCo model as a scene of ours.

    Attributes:
        scene: What is simulated; its soft bodies have their meshes as arrays.
        surfaces: What the mesh files of its rigid bodies hold, by the names of the files.
        told: What was not taken over, or otherwise, a sentence each.
        flexes: Name of each soft body with the vertices of MuJoCo that it is, as a slice of all of them.
        free: Names of the rigid bodies that move by themselves, with MuJoCo's names of them.
    """

    scene: SceneDescription
    surfaces: Mapping[str, SurfaceMesh]
    told: tuple[str, ...]
    flexes: Mapping[str, slice]
    free: Mapping[str, str]


def import_mjcf(path: str | Path, law: str | None = None) -> ImportedScene:
    """Read a MuJoCo model as a scene.

    Args:
        path: An MJCF file; everything that it names must lie in its folder, or below.
        law: Law of its soft bodies, one of Young modulus and Poisson ratio; None: that of scenes that name
            none. MuJoCo's own is saint_venant_kirchhoff.

    Raises:
        MjcfError: MuJoCo is missing, or the file is refused, with the reason; or nothing of it is left.
    """
    loaded = load_model(path)
    try:
        return _converted(loaded, law)
    except (SceneError, MeshError) as error:
        raise MjcfError(loaded.file, f"does not become a scene: {error}") from error


def _converted(loaded: Loaded, law: str | None) -> ImportedScene:
    found, joints = carriers(loaded)
    soft = soft_bodies(loaded, found, law)
    rigid = rigid_bodies(loaded, found)
    surfaces, contact = collisions(loaded, soft, rigid, joints)
    m = loaded.model
    gravity = np.zeros(3) if _is_off(loaded, "GRAVITY") else np.array(m.opt.gravity)
    scene = SceneDescription(
        name=Names().new(str(loaded.spec.modelname), "model"),
        dt=float(m.opt.timestep),
        gravity=vector(gravity),
        solver=SolverSettings(rayleigh_stiffness=_damping(loaded, soft)),
        bodies=tuple(each.body for each in soft),
        joints=(*joints, *cables(loaded, soft, found)),
        attachments=tuple(held for each in soft for held in each.attachments),
        rigid_bodies=tuple(each.description for each in rigid),
        collisions=surfaces,
        contact=contact,
    )
    if not (scene.bodies or scene.rigid_bodies):
        raise MjcfError(loaded.file, "has no soft body and no geom that a scene here can hold")
    starts = np.array(m.flex_vertadr)
    return ImportedScene(
        scene=scene,
        surfaces={f"{each.description.name}.stl": each.surface for each in rigid if each.surface},
        told=(*loaded.told.lines, *remaining(loaded.source)),
        flexes={
            each.body.name: slice(int(starts[each.flex]), int(starts[each.flex] + m.flex_vertnum[each.flex]))
            for each in soft
        },
        free={
            each.description.name: m.body(m.body_weldid[m.geom_bodyid[each.geoms[0]]]).name
            for each in rigid
            if each.description.mass is not None
        },
    )


def _is_off(loaded: Loaded, word: str) -> bool:
    return bool(loaded.model.opt.disableflags & getattr(loaded.mujoco.mjtDisableBit, f"mjDSBL_{word}"))


def _damping(loaded: Loaded, soft: tuple[SoftBody, ...]) -> float:
    """Rayleigh damping in [s]; a scene of ours has one for all bodies."""
    values = sorted({each.damping for each in soft})
    if len(values) > 1:
        loaded.told.say(
            "flexes", f"elasticity damping differs: all bodies have the least, {values[0]:g} s, here"
        )
    return values[0] if values else 0.0
