from .batches import (
    allocate_aligned as allocate_aligned,
    cell_batches as cell_batches,
    count_folded as count_folded,
    largest_strain_change as largest_strain_change,
    node_pairs as node_pairs,
)
from .cells import (
    PlannedCells as PlannedCells,
    RelaxingCells as RelaxingCells,
    assemble_cells as assemble_cells,
    assemble_tangent as assemble_tangent,
    couplings as couplings,
    deforming as deforming,
)
from .elements import (
    CLAMPED as CLAMPED,
    EXACT as EXACT,
    FROZEN as FROZEN,
    assemble_nodes as assemble_nodes,
)
from .laws import (
    compiled_law as compiled_law,
    point_cells as point_cells,
    tune as tune,
)
from .points import (
    CellInputs as CellInputs,
    CellOutputs as CellOutputs,
)
from .stretches import nearest_rotations as nearest_rotations
