"""Import of a MuJoCo model to a scene in a folder: description, meshes, a list of the parts left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from softsim_core.base import FormerAttribute, MeshError, MeshFile, MjcfError, SceneError, write_file
from softsim_core.mjcf.carriers import carriers, vector
from softsim_core.mjcf.flexes import cables, soft_bodies
from softsim_core.mjcf.geoms import rigid_bodies
from softsim_core.mjcf.reading import CompiledModel, Names, load_model
from softsim_core.mjcf.source import Source
from softsim_core.mjcf.touching import collisions
from softsim_core.physics.mesh import SurfaceMesh, TetMesh, write_surface, write_tets
from softsim_core.scene import SceneDescription, SolverSettings, as_robot
from softsim_core.scene.io import comment, write_description

_POSE = "name class pos quat axisangle xyaxes zaxis euler"
_READ: Final = {
    "option": "timestep gravity",
    "flag": "contact gravity filterparent",
    "body": f"{_POSE} childclass mocap",
    "frame": f"{_POSE} childclass",
    "inertial": f"{_POSE} mass diaginertia fullinertia",
    "joint": "name class type pos axis ref range limited stiffness springref armature",
    "freejoint": "name align",
    "geom": f"{_POSE} type size fromto mass density mesh rgba contype conaffinity friction hfield "
    "shellinertia fitscale group",
    "site": f"{_POSE} type size fromto group rgba",
    "flexcomp": f"{_POSE} type group dim count spacing point element texcoord mass inertiabox file rigid "
    "radius rgba origin scale dof cellcount",
    "flex": "name class dim radius body vertex element rgba node group dof cellcount texcoord elemtexcoord",
    "elasticity": "young poisson damping",
    "pin": "id range grid gridrange",
    "exclude": "name body1 body2",
    "spatial": "name class limited range stiffness damping group width rgba",
    "position": "name class joint tendon kp gear ctrllimited ctrlrange",
    "motor": "name class joint tendon gear ctrllimited ctrlrange",
    "general": "name class joint tendon gear ctrllimited ctrlrange gainprm biasprm gaintype biastype dyntype",
    "mesh": None,
}
"""Attributes by tag that are imported or reported by the conversion itself; None: all of them."""

_UNDER: Final = {
    ("flexcomp", "contact"): "contype conaffinity friction",
    ("flex", "contact"): "contype conaffinity friction",
    ("spatial", "site"): "site",
    ("spatial", "geom"): "geom sidesite",
}
"""Attributes of tags whose meaning depends on the tags above them."""

_WHOLE: Final = ("mujoco", "compiler", "default", "worldbody", "include", "replicate", "asset", "deformable")
_HOLDERS: Final = ("contact", "tendon", "actuator", "extension", "custom")
"""Tags that only contain others, and tags that MuJoCo's own reader resolves."""

_PICTURES: Final = ("light", "camera", "texture", "material", "skin", "visual", "statistic", "layer")
_SECTIONS: Final = ("sensor", "equality", "keyframe", "custom", "extension", "visual")
_MOST_NAMES: Final = 4


def remaining(source: Source) -> tuple[str, ...]:
    """Return a line for each element and attribute that is not imported, with the names of its owners."""
    found: dict[str, dict[str, list[str]]] = {}
    for element, above in source.elements():
        tag, parent = element.tag, above[-1] if above else ""
        if tag in _PICTURES or any(each in ("visual", "skin") for each in above):
            found.setdefault("pictures alone", {}).setdefault("", []).append(tag)
        elif parent in _SECTIONS:
            found.setdefault(f"{parent}/{tag}", {}).setdefault("", []).append(element.get("name", ""))
        elif tag in _WHOLE or (tag in (*_HOLDERS, *_SECTIONS) and parent in ("mujoco", "")):
            continue
        elif all(each in (*_READ, *_WHOLE, *_HOLDERS) for each in above):  # else one above is reported whole
            is_under = (parent, tag) in _UNDER
            read = _UNDER[parent, tag] if is_under else _READ.get(tag, "")
            left = [] if read is None else [name for name in element.attrib if name not in read.split()]
            called = f"{parent}/{tag}" if is_under or tag not in _READ else tag
            for name in left if is_under or tag in _READ else [""]:
                found.setdefault(called, {}).setdefault(name, []).append(element.get("name", ""))
    return tuple(_lines(found))


def _lines(found: dict[str, dict[str, list[str]]]) -> Iterator[str]:
    for tag, attributes in found.items():
        if tag == "pictures alone":
            kinds = attributes[""]
            counted = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
            yield f"pictures alone, not taken over: {counted}"
            continue
        by_names: dict[tuple[str, ...], list[str]] = {}
        for attribute, names in attributes.items():
            by_names.setdefault(tuple(names), []).append(attribute)
        for owners, which in by_names.items():
            what = ", ".join(each for each in which if each) or "the whole element"
            named = [name for name in owners if name]
            shown = ", ".join(named[:_MOST_NAMES]) + (", ..." if len(named) > _MOST_NAMES else "")
            if len(owners) > 1:
                shown = f"{len(owners)} of them" + (f": {shown}" if shown else "")
            yield f"{tag}: {what} not taken over" + (f" ({shown})" if shown else "")


@dataclass(frozen=True, slots=True, eq=False)
class ImportedScene:
    """A MuJoCo model as a scene.

    Attributes:
        scene: The scene; its soft bodies have their meshes as arrays.
        surfaces: Contents of the mesh files of its rigid bodies, by file name.
        remarks: Messages on parts that were not imported or changed.
        flexes: Vertices of each soft body in MuJoCo by name, as a slice of all of them.
        free: Names of the free rigid bodies, with their names in MuJoCo.
    """

    scene: SceneDescription
    surfaces: Mapping[str, SurfaceMesh]
    remarks: tuple[str, ...]
    told = FormerAttribute("remarks")
    flexes: Mapping[str, slice]
    free: Mapping[str, str]


def import_mjcf(path: str | Path, law: str | None = None) -> ImportedScene:
    """Import a MuJoCo model as a scene.

    Args:
        path: An MJCF file; everything that it names must lie in its folder, or below.
        law: Law of its soft bodies, one of Young modulus and Poisson ratio; None: the default law of scenes.
            MuJoCo's own is saint_venant_kirchhoff.

    Raises:
        MjcfError: MuJoCo is missing, the file is rejected, with the reason, or no supported part is left.
    """
    loaded = load_model(path)
    try:
        return _convert_model(loaded, law)
    except (SceneError, MeshError) as error:
        raise MjcfError(loaded.file, f"does not become a scene: {error}") from error


def _convert_model(loaded: CompiledModel, law: str | None) -> ImportedScene:
    found, joints = carriers(loaded)
    soft = soft_bodies(loaded, found, law)
    rigid = rigid_bodies(loaded, found)
    surfaces, contact = collisions(loaded, soft, rigid, joints)
    m = loaded.model
    no_gravity = m.opt.disableflags & loaded.mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity = np.zeros(3) if no_gravity else np.array(m.opt.gravity)
    damping = sorted({each.damping for each in soft})  # a scene has one value for all bodies
    if len(damping) > 1:
        note = f"elasticity damping differs: all bodies have the least, {damping[0]:g} s, here"
        loaded.notes.say("flexes", note)
    scene = SceneDescription(
        name=Names().new(str(loaded.spec.modelname), "model"),
        dt=float(m.opt.timestep),
        gravity=vector(gravity),
        solver=SolverSettings(rayleigh_stiffness=damping[0] if damping else 0.0),
        bodies=tuple(each.body for each in soft),
        joints=(*joints, *cables(loaded, soft, found)),
        attachments=tuple(attachment for each in soft for attachment in each.attachments),
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
        remarks=(*loaded.notes.lines, *remaining(loaded.source)),
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


def write_imported(imported: ImportedScene, folder: str | Path, origin: str) -> Path:
    """Write a scene and its meshes into a folder; return the scene's file.

    The folder is created, and files of these names in it are replaced. The first line names the `origin`.

    Raises:
        MjcfError, MeshError: a file cannot be written.
    """
    folder = Path(folder)
    scene = imported.scene
    try:
        folder.mkdir(parents=True, exist_ok=True)
        bodies = []
        for body in scene.bodies:
            assert isinstance(body.mesh, TetMesh)  # as in all imported bodies
            file = Path(f"{body.name}.msh")
            write_tets(folder / file, body.mesh)
            bodies.append(replace(body, mesh=MeshFile(file=file)))
        for name, surface in imported.surfaces.items():
            write_surface(folder / name, surface)
        written = folder / f"{scene.name}.yaml"
        robot = as_robot(replace(scene, bodies=tuple(bodies)))
        head = [f"{scene.name}: made of {origin} (MuJoCo). SI units (m, kg, s, Pa)."]
        if imported.remarks:
            head += ["Not taken over, or otherwise than there:", *(f"  {note}" for note in imported.remarks)]
        write_file(written, comment(*head) + write_description(robot, given_only=True))
    except OSError as error:
        raise MjcfError(folder, f"cannot be written: {error.strerror or error}") from error
    return written
