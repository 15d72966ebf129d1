from .collision_model import (
    CollisionModel as CollisionModel,
    Place as Place,
    VertexCarrier as VertexCarrier,
)
from .compile import (
    compiler as compiler,
    kernel as kernel,
)
from .detection import (
    Detector as Detector,
    Proximities as Proximities,
)
from .linearised import (
    LinearisedContacts as LinearisedContacts,
    linearise as linearise,
)
from .settings import (
    ContactLimits as ContactLimits,
    ContactSettings as ContactSettings,
    PairFriction as PairFriction,
)
from .solver import (
    solve_contacts as solve_contacts,
)
from .surfaces import (
    CollisionSurface as CollisionSurface,
    check_surface as check_surface,
    crossings as crossings,
    first_overlap as first_overlap,
    may_meet as may_meet,
    surfaces_cross as surfaces_cross,
    touching as touching,
)
