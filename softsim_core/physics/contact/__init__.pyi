from .collision_model import (
    CollisionModel as CollisionModel,
    Place as Place,
    VertexCarrier as VertexCarrier,
)
from .compile import compiler as compiler
from .detection import (
    Detector as Detector,
    Proximities as Proximities,
)
from .linearised import (
    LinearisedContacts as LinearisedContacts,
    linearise as linearise,
)
from .overlap import (
    first_overlap as first_overlap,
    touching as touching,
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
    may_meet as may_meet,
    surfaces_cross as surfaces_cross,
)
from .warmup import warm_up_contact as warm_up_contact
