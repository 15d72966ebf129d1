from .cells import (
    BlockPattern as BlockPattern,
    cauchy_stress as cauchy_stress,
    cell_energy as cell_energy,
    cell_forces as cell_forces,
    cell_stiffness as cell_stiffness,
    cell_von_mises as cell_von_mises,
    deformation_gradients as deformation_gradients,
    elastic_forces as elastic_forces,
    inverted_cells as inverted_cells,
    mean_volume_answer as mean_volume_answer,
    mean_volume_law as mean_volume_law,
    split_bulk as split_bulk,
    stiffness_matrix as stiffness_matrix,
    strain_change as strain_change,
    stress_at_nodes as stress_at_nodes,
    takes_found_stress as takes_found_stress,
    von_mises_stress as von_mises_stress,
)
from .group import (
    ElementGroup as ElementGroup,
    element_group as element_group,
    empty_group as empty_group,
    fibre_group as fibre_group,
    layer_group as layer_group,
    locking_warning as locking_warning,
)
from .mass import (
    MassCoupling as MassCoupling,
    mass_coupling as mass_coupling,
    volume_shares as volume_shares,
)
from .prony import (
    FLATTEST as FLATTEST,
    during_step as during_step,
    fading as fading,
    forget as forget,
    memory_shape as memory_shape,
    remember as remember,
    step_stress as step_stress,
    step_stress_forces as step_stress_forces,
    step_stress_stiffness as step_stress_stiffness,
)
