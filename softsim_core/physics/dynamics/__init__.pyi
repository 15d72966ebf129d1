from .actuator_statics import (
    command_gains as command_gains,
    condense_tangent as condense_tangent,
    on_nodes as on_nodes,
    reduced_stiffness as reduced_stiffness,
    rows_on_unknowns as rows_on_unknowns,
    taut_commands as taut_commands,
)
from .assembly import (
    Unknowns as Unknowns,
    generalised_forces as generalised_forces,
    jacobian as jacobian,
    node_stiffness as node_stiffness,
    static_tangent as static_tangent,
)
from .backends import (
    has_compiled_step as has_compiled_step,
    make_stepper as make_stepper,
)
from .contact_step import runaway_speed as runaway_speed
from .iterations import FreeTurning as FreeTurning
from .memory import let_relax as let_relax
from .report import (
    PART_OF as PART_OF,
    ContactReport as ContactReport,
    StageShare as StageShare,
    StepReport as StepReport,
    nothing as nothing,
    stage_tree as stage_tree,
)
from .scipy_backend import ScipyStepper as ScipyStepper
from .statics import (
    Leading as Leading,
    StaticResponse as StaticResponse,
    StaticSolution as StaticSolution,
    response_of as response_of,
    solve_static as solve_static,
)
from .step import (
    StepSettings as StepSettings,
    TimeStep as TimeStep,
)
from .stepper import (
    Condensed as Condensed,
    Stepper as Stepper,
)
from .substeps import (
    strain_measure as strain_measure,
    torn_by_rough_steps as torn_by_rough_steps,
)
