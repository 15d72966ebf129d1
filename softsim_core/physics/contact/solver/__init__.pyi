from .gauss_seidel import (
    ContactSolution as ContactSolution,
    solve_contacts as solve_contacts,
)
from .law import (
    ContactProblem as ContactProblem,
    eliminate as eliminate,
)
from .smoothing import (
    Smoothed as Smoothed,
    project as project,
    steepness as steepness,
)
