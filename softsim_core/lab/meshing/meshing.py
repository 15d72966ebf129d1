"""Meshing of a part's file: read, repair, simplify, fill with tetrahedra, check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np

from softsim_core.base import FormerAttribute, MeshError
from softsim_core.lab.meshing.filling import (
    Filling,
    fill_surface,
    key_of,
    pieces,
    read_cached_mesh,
    store_mesh,
)
from softsim_core.lab.meshing.openings import open_hollows, without_channel
from softsim_core.lab.meshing.part import Part, read_part
from softsim_core.lab.meshing.repair import RepairedSurface, repair_part
from softsim_core.lab.meshing.sizing import TOLERANCE, Sized, simplify_surface, with_nodes
from softsim_core.lab.meshing.topology import largest_distance
from softsim_core.physics.mesh import (
    MeshReport,
    SurfaceMesh,
    TetMesh,
    boundary_surface,
    check_tets,
    quadratic,
)

NODES = 1000
"""Requested number of nodes if neither size nor number is given."""
NEAR_ENOUGH = 0.3
"""Tolerance of this default number; an explicit number is met within sizing.TOLERANCE."""
DEVIATION = 1.0e-3
"""Default of the largest deviation of the mesh from the surface, as a part of the part's diagonal."""
_FAR = 3.0  # a mesh that deviates by more than this multiple of the allowed deviation is rejected
_VOLUME = 0.05  # a mesh with a volume error above this part is rejected
_POOR_DEG = 5.0
_LONGEST = 0.2  # longest edges that are tried for a requested number of nodes, as a part of the diagonal


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshingOptions:
    """Requested properties of a mesh.

    Attributes:
        unit: Unit of the part's file, one of part.UNITS.
        size: Requested length of edges in [m]; None: `nodes` is used.
        nodes: Requested number of nodes; None with `size`, else NODES.
        order: 1, or 2 with a node in the middle of each edge.
        hole: Largest hole in [m] to close; None: repair.HOLE of the longest side.
        largest: Use only the largest body if there are several.
        plug: Close the openings of cavities, such as air inlets, with plugs.
        deviation: Largest deviation of the mesh from the surface in [m]; None: DEVIATION of the diagonal.
        time_limit: Time limit in [s] of one run of the mesher.
    """

    unit: str = "mm"
    size: float | None = None
    nodes: int | None = None
    order: int = 1
    hole: float | None = None
    largest: bool = False
    plug: bool = False
    deviation: float | None = None
    time_limit: float = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class MeshedPart:
    """A part's mesh and its quality.

    Attributes:
        mesh: Tetrahedra in [m].
        source: The repaired surface.
        report: Quality figures of the mesh.
        edge: Requested length of edges in [m].
        distance: Largest distance between the mesh's boundary and the surface in [m].
        remarks: Messages about repairs and unusual properties.
        from_cache: Whether it was taken from the cache.
    """

    mesh: TetMesh
    source: RepairedSurface
    report: MeshReport
    edge: float
    distance: float
    remarks: tuple[str, ...]
    from_cache: bool
    told, known = FormerAttribute("remarks"), FormerAttribute("from_cache")

    @property
    def volume_error(self) -> float | None:
        """Relative error of the mesh's volume; None if the surface intersects itself."""
        return None if self.source.crosses else self.report.volume / self.source.volume - 1.0


def mesh_part(
    path: str | PathLike[str],
    options: MeshingOptions,
    progress: Callable[[str], None] = lambda line: None,
    fill: Callable[[SurfaceMesh, float, Filling], TetMesh] = fill_surface,
) -> MeshedPart:
    """Mesh a part with tetrahedra.

    The same file with the same options gives the same mesh, as long as it is in the cache.

    Args:
        path: A surface in a file that `part.read_part` reads.
        options: Requested properties.
        progress: Called with messages about the present stage.
        fill: Function that fills a closed surface with edges of a length.

    Raises:
        MeshError: the part cannot be read, repaired or filled, or the mesh does not follow its surface.
    """
    if options.size is not None and options.nodes is not None:
        raise MeshError("", "size and number of nodes are two ways to say one thing; say one of them")
    if options.order not in (1, 2):
        raise MeshError("", f"order {options.order} is not known; 1 is linear, 2 quadratic")
    progress(f"reading {path}")
    part = read_part(path, options.unit)
    count = len(part.surface.triangles)
    progress(f"looking at {count} triangles, {part.unit.size(np.ptp(part.surface.points, axis=0))}")
    for doubt in part.remarks:
        progress(doubt)
    source = repair_part(part, options.hole, options.largest, simplify_surface)
    settings = asdict(replace(options, time_limit=0.0))
    if options.plug:
        source = _plug_cavities(part, source, options)
    else:
        del settings["plug"]  # preserves the keys of meshes from before plugs were supported
    key = key_of(Path(path).read_bytes(), settings)
    made = read_cached_mesh(key)
    if made is None:
        sized = _mesh_to_size(source, options, progress, fill)
        result = _check_mesh(part, source, sized.mesh, sized.edge, options)
        if not store_mesh(key, sized.mesh, sized.edge):
            remark = "the cache cannot be written: the next run makes another mesh"
            result = replace(result, remarks=(*result.remarks, remark))
        return result
    progress("taking the mesh that was made before of the same file and options")
    mesh, edge = made
    return replace(_check_mesh(part, source, replace(mesh, name=str(path)), edge, options), from_cache=True)


def _plug_cavities(part: Part, source: RepairedSurface, options: MeshingOptions) -> RepairedSurface:
    """Return a part with the openings of its cavities closed by plugs."""
    unit, remarks = source.unit, list(source.remarks)
    openings = open_hollows(source.surface)
    if not openings:
        raise MeshError(
            part.surface.name, "no hollow with a narrow opening was found that a plug could close"
        )
    for each in openings:
        cut = replace(part, surface=without_channel(source.surface, each), remarks=())
        source = repair_part(cut, float("inf"), options.largest)
        remarks.append(f"plugged the opening of {unit.length(each.width)} at {unit.place(each.place)}")
    remarks.append(f"{source.cavities} closed hollow{'s' * (source.cavities != 1)} now")
    return replace(source, remarks=tuple(remarks))


def _mesh_to_size(
    source: RepairedSurface,
    options: MeshingOptions,
    progress: Callable[[str], None],
    fill: Callable[[SurfaceMesh, float, Filling], TetMesh],
) -> Sized:
    how = Filling(
        envelope=_deviation(source, options) / _diagonal(source),
        time_limit=options.time_limit,
        waited=lambda seconds: progress(f"filling: {seconds:.0f} s of at most {options.time_limit:g} s"),
    )

    def one(edge: float, coarsen: bool = False) -> TetMesh:
        progress(f"filling with edges of {source.unit.length(edge)}" + (", as few as possible" * coarsen))
        mesh = fill(source.surface, edge, replace(how, coarsen=coarsen))
        return quadratic(mesh) if options.order == 2 else mesh

    if options.size is not None:
        return Sized(one(options.size), options.size, 1)
    requested, longest = options.nodes or NODES, _LONGEST * _diagonal(source)
    tolerance = TOLERANCE if options.nodes else NEAR_ENOUGH
    sized = with_nodes(one, source.volume, longest, requested, tolerance)
    if len(sized.mesh.points) <= (1.0 + tolerance) * requested:
        return sized
    try:
        fewer = with_nodes(lambda edge: one(edge, coarsen=True), source.volume, longest, requested, tolerance)
    except MeshError as error:
        progress(f"that was in vain ({error}): taking the best so far")
        return sized
    return min(sized, fewer, key=lambda each: abs(len(each.mesh.points) - requested))


def _check_mesh(
    part: Part, source: RepairedSurface, mesh: TetMesh, edge: float, options: MeshingOptions
) -> MeshedPart:
    """Check a mesh and return it with its quality; raise MeshError if it does not represent the part.

    Straight edges cannot invert a quadratic cell with the corners of a valid linear one.
    """
    name, unit, remarks = part.surface.name, source.unit, list(source.remarks)
    mesh = replace(mesh, name=name)
    report = check_tets(mesh)
    parts = pieces(mesh)
    if len(parts) > 1:
        raise MeshError(
            name,
            f"its mesh falls into {len(parts)} pieces that hang together by an edge or a point, or not at "
            f"all, of {parts[0]} and {parts[1]} tetrahedra and so on; join them in the CAD program, or ask "
            "for a finer mesh",
        )
    skin = boundary_surface(mesh)
    off, where = largest_distance(skin, source.surface)
    if not source.crosses:
        other, there = largest_distance(source.surface, skin)
        off, where = (off, where) if off >= other else (other, there)
    allowed = _deviation(source, options)
    if off > _FAR * allowed:
        raise MeshError(
            name,
            f"its mesh deviates by {unit.length(off)} from the surface at {unit.place(where)}, where "
            f"{unit.length(allowed)} was allowed; ask for a finer mesh (--size, --nodes), or mend the part "
            "there",
        )
    named = replace(mesh, name=Path(name).name)  # the same bytes for any folder of the file
    result = MeshedPart(named, source, report, edge, off, (), False)
    error = result.volume_error
    if error is not None and abs(error) > _VOLUME:
        raise MeshError(
            name,
            f"the volume of its mesh is off by {100.0 * error:+.1f} %: walls are as thin as what the mesh "
            f"may deviate ({unit.length(allowed)}); allow less with --deviation",
        )
    if report.min_dihedral_deg < _POOR_DEG:
        remarks.append(f"the worst element has an angle of {report.min_dihedral_deg:.1f} degrees only")
    requested = options.nodes or NODES
    if options.size is None and abs(report.nodes / requested - 1.0) > TOLERANCE:
        more = report.nodes > requested
        remarks.append(
            f"{report.nodes} nodes are the nearest to {requested} that were found"
            + (f": more deviation from the surface than {unit.length(allowed)} allows fewer" if more else "")
        )
    return replace(result, remarks=tuple(remarks))


def _deviation(source: RepairedSurface, options: MeshingOptions) -> float:
    return DEVIATION * _diagonal(source) if options.deviation is None else options.deviation


def _diagonal(source: RepairedSurface) -> float:
    return float(np.linalg.norm(np.ptp(source.surface.points, axis=0)))
