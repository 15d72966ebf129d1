from .cells import (
    BENDING as BENDING,
    CIRCLE as CIRCLE,
    SHORTEST as SHORTEST,
    RodGroup as RodGroup,
    RodSections as RodSections,
    StrainPoints as StrainPoints,
    join_rods as join_rods,
    rod_drag as rod_drag,
    rod_group as rod_group,
    rod_viscosity as rod_viscosity,
)
