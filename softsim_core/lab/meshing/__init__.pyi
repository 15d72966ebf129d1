from .filling import (
    Filling as Filling,
    filled as filled,
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
    repaired as repaired,
)
from .sizing import (
    simplified as simplified,
    with_nodes as with_nodes,
)
from .topology import (
    distances as distances,
    largest_distance as largest_distance,
)
