from .corotational import (
    FLAT as FLAT,
    SMALLEST_VOLUME as SMALLEST_VOLUME,
    Corotational as Corotational,
    RotatedHooke as RotatedHooke,
    polar_rotations as polar_rotations,
)
from .elastomers import (
    DEFAULT_FIT as DEFAULT_FIT,
    FITTED_LAWS as FITTED_LAWS,
    SILICONE_POISSON_RATIO as SILICONE_POISSON_RATIO,
    Elastomer as Elastomer,
    RestStiffness as RestStiffness,
    elastomer as elastomer,
    elastomer_names as elastomer_names,
    rest_stiffness as rest_stiffness,
    stiffness_warning as stiffness_warning,
    tension as tension,
)
from .law import (
    Material as Material,
    MaterialParameter as MaterialParameter,
    PointLaw as PointLaw,
    TangentModes as TangentModes,
    VolumetricMaterial as VolumetricMaterial,
    clamp_tangent as clamp_tangent,
    compile_points as compile_points,
    lame as lame,
    von_mises as von_mises,
)
from .mooney_rivlin import MooneyRivlin as MooneyRivlin
from .ogden import Ogden as Ogden
from .registry import (
    material as material,
    material_names as material_names,
    register_material as register_material,
)
from .relaxation import (
    SHARE as SHARE,
    TIME as TIME,
    Relaxing as Relaxing,
    law_within as law_within,
    relaxing as relaxing,
)
from .rubber import (
    Rubber as Rubber,
    SeriesRubber as SeriesRubber,
)
from .section import (
    DAMPING as DAMPING,
    SECTION as SECTION,
    Section as Section,
)
from .strain import (
    FIBRES as FIBRES,
    MEMBRANE as MEMBRANE,
    SLACK as SLACK,
    Fibres as Fibres,
    Membrane as Membrane,
    StrainMaterial as StrainMaterial,
    without_pressing as without_pressing,
)
from .stretches import (
    LEAST_STRETCH as LEAST_STRETCH,
    cofactor as cofactor,
)
