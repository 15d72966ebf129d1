from .chosen import (
    RestShapes as RestShapes,
    chosen_by as chosen_by,
)
from .document import (
    Proposal as Proposal,
    SceneDocument as SceneDocument,
    apply_edits as apply_edits,
    rebase_paths as rebase_paths,
)
from .edits import (
    Edit as Edit,
    Put as Put,
    Remove as Remove,
)
from .parts import (
    Region as Region,
    add_attachment as add_attachment,
    add_cable as add_cable,
    add_chamber as add_chamber,
    add_collision as add_collision,
    add_mass as add_mass,
    plain_masses as plain_masses,
    plain_vector as plain_vector,
    regions_of as regions_of,
    remove as remove,
    reshape_region as reshape_region,
    route as route,
    routed_points as routed_points,
)
