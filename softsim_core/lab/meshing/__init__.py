"""From the surface of a part, as CAD programs export it, to tetrahedra: `mesh_part`."""

from softsim_core.lab.meshing.filling import have_mesher
from softsim_core.lab.meshing.meshing import MeshedPart, MeshingOptions, mesh_part
from softsim_core.lab.meshing.part import Part, read_part
from softsim_core.lab.meshing.repair import Repaired, repaired

__all__ = [
    "MeshedPart",
    "MeshingOptions",
    "Part",
    "Repaired",
    "have_mesher",
    "mesh_part",
    "read_part",
    "repaired",
]
