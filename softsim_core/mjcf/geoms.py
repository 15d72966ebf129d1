"""Rigid bodies and surfaces of a MuJoCo model: its geoms, on their carriers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softsim_core.base import Array, MeshError, MeshFile
from softsim_core.mjcf.carriers import Carrier, colour, placement, vector
from softsim_core.mjcf.reading import CompiledModel
from softsim_core.physics.mesh import Shape, SurfaceMesh, sphere_surface, surface_of
from softsim_core.scene import RigidBodyDescription

_OFF_CENTRE = 1e-3
"""Tolerance of the centre of mass relative to that of the shape, as a part of the body's size."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidGeom:
    """A rigid body of one geom, or of all geoms of a free body.

    Attributes:
        description: The body.
        geoms: MuJoCo's numbers of the geoms.
        surface: Content of its mesh file, or None if it has no such file.
        moves: Whether it is free.
        carrier: Its carrier, or itself.
    """

    description: RigidBodyDescription
    geoms: tuple[int, ...]
    surface: SurfaceMesh | None
    moves: bool
    carrier: str


def rigid_bodies(loaded: CompiledModel, found: dict[int, Carrier]) -> tuple[RigidGeom, ...]:
    """Convert all geoms with a supported surface; report the others."""
    m = loaded.model
    rigid: list[RigidGeom] = []
    for b, carrier in found.items():
        geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] == b and _usable(loaded, g)]
        if carrier.kind == "free":
            if carrier.body == b:
                with_it = [k for k, each in found.items() if each.body == b]
                geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] in with_it and _usable(loaded, g)]
                rigid += _free(loaded, carrier, tuple(geoms), with_it)
        else:
            rigid += [_build_rigid_geom(loaded, carrier, g) for g in geoms]
    return tuple(rigid)


def _usable(loaded: CompiledModel, g: int) -> bool:
    word = loaded.mujoco.mjtGeom(int(loaded.model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
    if word not in ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"):
        note = f"type {word} is not taken over; its shape has no surface here"
        loaded.notes.say(_describe_geom(loaded, g), note)
        return False
    return True


def _describe_geom(loaded: CompiledModel, g: int) -> str:
    """Return the name of a geom in messages."""
    m = loaded.model
    body = int(m.geom_bodyid[g])
    return f"geom {m.geom(g).name or g} of {m.body(body).name or f'body {body}'}"


def _pose(loaded: CompiledModel, g: int) -> tuple[Array, Array]:
    return np.array(loaded.data.geom_xpos[g]), np.array(loaded.data.geom_xmat[g]).reshape(3, 3)


def _build_rigid_geom(loaded: CompiledModel, carrier: Carrier, g: int) -> RigidGeom:
    m = loaded.model
    otherwise = m.body(m.geom_bodyid[g]).name or "geom"
    name = loaded.names.new(m.geom(g).name, "ground" if otherwise == "world" else otherwise)
    place, turn = _pose(loaded, g)
    shape, surface = _shape(loaded, g, name)
    description = RigidBodyDescription(
        name=name,
        shape=shape,
        pose=placement(carrier.rotation.T @ (place - carrier.origin), carrier.rotation.T @ turn),
        on=carrier.name,
        colour=colour(m.geom_rgba[g]),
    )
    return RigidGeom(description, (g,), surface, carrier.kind != "world", carrier.name)


def _free(
    loaded: CompiledModel, carrier: Carrier, geoms: tuple[int, ...], bodies: list[int]
) -> Iterator[RigidGeom]:
    """Yield a free body, with everything welded to it."""
    m = loaded.model
    if not geoms:
        loaded.notes.say(f"body {carrier.name}", "has no geom with a surface: it is not taken over")
        return
    mass, centre, inertia = _weight(loaded, bodies)
    if len(geoms) == 1:
        place, turn = _pose(loaded, geoms[0])
        shape, surface = _shape(loaded, geoms[0], carrier.name)
    else:
        loaded.notes.say(f"body {carrier.name}", f"its {len(geoms)} geoms are their convex hull here")
        place, turn = centre, carrier.rotation
        clouds = []
        for g in geoms:
            one, drawn = _shape(loaded, g, "part")
            at, turned = _pose(loaded, g)
            clouds.append(((drawn or surface_of(one)).points @ turned.T + at - place) @ turn)
        surface = _hull(np.concatenate(clouds))
        shape = Shape(mesh=MeshFile(file=Path(f"{carrier.name}.stl")))
    own = turn.T @ inertia @ turn
    points = (surface or surface_of(shape)).points
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if np.linalg.norm(centre - place) > _OFF_CENTRE * size and shape.mesh is None:
        loaded.notes.say(f"body {carrier.name}", "its centre of mass is that of its shape here")
    if np.abs(own - np.diag(np.diag(own))).max() > 1e-3 * np.trace(own):
        loaded.notes.say(f"body {carrier.name}", "its products of inertia are not taken over")
    description = RigidBodyDescription(
        name=carrier.name,
        shape=shape,
        mass=float(f"{mass:.9g}"),
        inertia=vector(np.diag(own)),
        pose=placement(place, turn),
        colour=colour(m.geom_rgba[geoms[0]]),
    )
    yield RigidGeom(description, geoms, surface, True, carrier.name)


def _weight(loaded: CompiledModel, bodies: list[int]) -> tuple[float, Array, Array]:
    """Return mass in [kg], centre (3,) in [m] and inertia (3, 3) about it in [kg m^2] of welded bodies."""
    m, d = loaded.model, loaded.data
    masses = np.array([m.body_mass[b] for b in bodies])
    centres = np.array([d.xipos[b] for b in bodies])
    mass = float(masses.sum())
    centre = masses @ centres / mass
    inertia = np.zeros((3, 3))
    for b, own, at in zip(bodies, masses, centres, strict=True):
        turn, arm = np.array(d.ximat[b]).reshape(3, 3), at - centre
        inertia += turn @ np.diag(m.body_inertia[b]) @ turn.T
        inertia += own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, inertia


def _shape(loaded: CompiledModel, g: int, name: str) -> tuple[Shape, SurfaceMesh | None]:
    """Return a geom's shape in its own frame, and the surface of its mesh file if it needs one."""
    m, kinds = loaded.model, loaded.mujoco.mjtGeom
    size, kind = [float(each) for each in m.geom_size[g]], m.geom_type[g]
    if kind == kinds.mjGEOM_SPHERE:
        return Shape(sphere=size[0]), None
    if kind == kinds.mjGEOM_BOX:
        return Shape(box=(2.0 * size[0], 2.0 * size[1], 2.0 * size[2])), None
    if kind == kinds.mjGEOM_CYLINDER:
        return Shape(cylinder=(size[0], 2.0 * size[1])), None
    if kind == kinds.mjGEOM_PLANE:
        x, y = size[0], size[1]
        if not (x > 0.0 and y > 0.0):
            most = 10.0 * float(m.stat.extent)
            note = f"its plane has no end in MuJoCo; here it is {2.0 * most:.3g} m wide"
            loaded.notes.say(_describe_geom(loaded, g), note)
            x, y = (x or most), (y or most)
        return Shape(plane=(2.0 * x, 2.0 * y)), None
    return Shape(mesh=MeshFile(file=Path(f"{name}.stl"))), _surface(loaded, g)


def _surface(loaded: CompiledModel, g: int) -> SurfaceMesh:
    """Return triangles of a capsule, an ellipsoid or a mesh in the geom's own frame."""
    m, kinds = loaded.model, loaded.mujoco.mjtGeom
    if m.geom_type[g] == kinds.mjGEOM_MESH:
        k = int(m.geom_dataid[g])
        vertices = slice(int(m.mesh_vertadr[k]), int(m.mesh_vertadr[k] + m.mesh_vertnum[k]))
        faces = slice(int(m.mesh_faceadr[k]), int(m.mesh_faceadr[k] + m.mesh_facenum[k]))
        note = "touches with its mesh here, in MuJoCo with the convex hull of it"
        loaded.notes.say(_describe_geom(loaded, g), note)
        points = np.array(m.mesh_vert[vertices], dtype=float)
        return SurfaceMesh(points, np.array(m.mesh_face[faces], dtype=np.int64), m.mesh(k).name)
    if m.geom_type[g] == kinds.mjGEOM_ELLIPSOID:
        round_one = sphere_surface(1.0)
        return SurfaceMesh(round_one.points * np.array(m.geom_size[g]), round_one.triangles, "ellipsoid")
    radius, half = float(m.geom_size[g, 0]), float(m.geom_size[g, 1])
    ball, up = sphere_surface(radius).points, np.array([0.0, 0.0, half])
    return _hull(np.concatenate([ball + up, ball - up]))


def _hull(points: Array) -> SurfaceMesh:
    """Return the convex hull of points (k, 3), outward."""
    try:
        hull = ConvexHull(points)
    except QhullError as error:
        problem = "geoms of a body enclose nothing together; give them volume"
        raise MeshError("convex hull", problem) from error
    used, numbers = np.unique(hull.simplices, return_inverse=True)
    triangles = numbers.reshape(-1, 3).astype(np.int64)
    corners = points[used][triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return SurfaceMesh(points[used], triangles, "hull")
