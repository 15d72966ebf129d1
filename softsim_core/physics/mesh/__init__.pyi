from .checks import (
    MeshReport as MeshReport,
    check_tets as check_tets,
    dihedral_angles_deg as dihedral_angles_deg,
    drop_unused_nodes as drop_unused_nodes,
    tet_volumes as tet_volumes,
)
from .embedding import (
    Embedding as Embedding,
    SurfaceFollower as SurfaceFollower,
    embed as embed,
    place as place,
    rotation_matrix as rotation_matrix,
)
from .formats import merge_corners as merge_corners
from .generators import (
    box_mesh as box_mesh,
    cell_mesh as cell_mesh,
    extrude as extrude,
    flip_to_delaunay as flip_to_delaunay,
    orient_tets as orient_tets,
    smooth as smooth,
    stitch as stitch,
    whole_cells as whole_cells,
)
from .readers import (
    read_surface as read_surface,
    read_tets as read_tets,
    write_surface as write_surface,
    write_tets as write_tets,
)
from .rods import (
    RodMesh as RodMesh,
    SweptMesh as SweptMesh,
    along_curve as along_curve,
    carried_axes as carried_axes,
    node_triangles as node_triangles,
    rod_mesh as rod_mesh,
    rod_surface as rod_surface,
    swept_mesh as swept_mesh,
)
from .shapes import (
    Shape as Shape,
    box_surface as box_surface,
    cylinder_surface as cylinder_surface,
    mass_properties as mass_properties,
    solid_properties as solid_properties,
    sphere_surface as sphere_surface,
    surface_of as surface_of,
)
from .surface import (
    boundary as boundary,
    boundary_faces as boundary_faces,
    boundary_surface as boundary_surface,
    cavities as cavities,
    closest_point as closest_point,
    enclosed_volume as enclosed_volume,
    encloses as encloses,
    euler_number as euler_number,
    flip_faces as flip_faces,
    is_closed as is_closed,
    triangle_normals as triangle_normals,
    triangles_of as triangles_of,
    winding_numbers as winding_numbers,
)
from .types import (
    MIDDLES as MIDDLES,
    TETRAHEDRA as TETRAHEDRA,
    SurfaceMesh as SurfaceMesh,
    TetMesh as TetMesh,
    cell_middles as cell_middles,
    linear as linear,
    quadratic as quadratic,
    subdivide_mesh as subdivide_mesh,
)
