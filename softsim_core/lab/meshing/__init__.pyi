from .filling import (
    Filling as Filling,
    fill_surface as fill_surface,
    have_mesher as have_mesher,
)
from .guesses import (
    Guess as Guess,
    end_face as end_face,
    guess as guess,
)
from .meshing import (
    MeshedPart as MeshedPart,
    MeshingOptions as MeshingOptions,
    mesh_part as mesh_part,
)
from .openings import (
    CELLS as CELLS,
    open_hollows as open_hollows,
    without_channel as without_channel,
)
from .part import (
    UNITS as UNITS,
    read_part as read_part,
)
from .repair import (
    RepairedSurface as RepairedSurface,
    repair_part as repair_part,
)
from .sizing import (
    simplify_surface as simplify_surface,
    with_nodes as with_nodes,
)
from .topology import (
    distances as distances,
    largest_distance as largest_distance,
)
