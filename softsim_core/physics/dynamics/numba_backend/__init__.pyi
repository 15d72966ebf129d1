from . import (
    elements as elements,
    elimination as elimination,
    stepper as stepper,
)
from .actuator_rows import bounded_forces as bounded_forces
from .batches import (
    cell_batches as cell_batches,
    count_folded as count_folded,
    largest_strain_change as largest_strain_change,
)
from .cells import RelaxingCells as RelaxingCells
from .elimination import TOLERANCE as TOLERANCE
from .laws import (
    compiled_law as compiled_law,
    point_cells as point_cells,
    tune as tune,
)
from .layout import (
    CellPlaces as CellPlaces,
    compiler as compiler,
    node_pairs as node_pairs,
)
from .points import (
    CellInputs as CellInputs,
    CellOutputs as CellOutputs,
)
from .stepper import NumbaStepper as NumbaStepper
from .stretches import nearest_rotations as nearest_rotations
