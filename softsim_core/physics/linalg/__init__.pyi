from . import cholesky as cholesky, conjugate as conjugate
from .bounded import (
    FACES_PER_FORCE as FACES_PER_FORCE,
    SMALLEST_PIVOT as SMALLEST_PIVOT,
    SOLVED as SOLVED,
    WRONG_SIDE as WRONG_SIDE,
    solve_bounded as solve_bounded,
)
from .cholesky import (
    FITS as FITS,
    factor as factor,
    forward_rows as forward_rows,
    forward_space as forward_space,
    solve_backward as solve_backward,
)
from .compile import (
    compiler as compiler,
    inline as inline,
    part as part,
)
from .conjugate import (
    LARGE as LARGE,
    Sharing as Sharing,
    conjugate_gradients as conjugate_gradients,
    copy_matrix as copy_matrix,
    multiply as multiply,
    precondition as precondition,
    reach as reach,
    sharing_of as sharing_of,
    support_gradients as support_gradients,
)
from .divided_factor import (
    Division as Division,
    allocate_panels as allocate_panels,
    divide_tree as divide_tree,
    lead_factor as lead_factor,
    support_factor as support_factor,
    with_space_for as with_space_for,
)
from .instructions import (
    LANES as LANES,
    ROWS as ROWS,
    add_block as add_block,
    dot_product as dot_product,
    host_processor as host_processor,
    steady_seconds as steady_seconds,
)
from .lanes import (
    bits_of as bits_of,
    gather as gather,
    put as put,
    put_quads as put_quads,
    root as root,
    row as row,
    subtract_at as subtract_at,
    where as where,
)
from .ordering import (
    LEAF as LEAF,
    column_counts as column_counts,
    elimination_order as elimination_order,
    elimination_tree as elimination_tree,
    factor_cost as factor_cost,
    graph_of as graph_of,
    minimum_degree as minimum_degree,
    nested_dissection as nested_dissection,
    postorder as postorder,
)
from .products import (
    Matrix as Matrix,
    Preconditioner as Preconditioner,
    matrix_layout as matrix_layout,
    matrix_of as matrix_of,
)
from .solver_interface import (
    Factoriser as Factoriser,
    Factors as Factors,
    LinearSolver as LinearSolver,
    Pattern as Pattern,
    Rows as Rows,
    SuperLU as SuperLU,
    factorise_matrix as factorise_matrix,
    spread_of as spread_of,
)
from .solvers import (
    AUTO as AUTO,
    COMPILED as COMPILED,
    ITERATIVE as ITERATIVE,
    choose_linear_solver as choose_linear_solver,
    linear_solver_names as linear_solver_names,
    register_linear_solver as register_linear_solver,
)
from .symbolic import (
    Factor as Factor,
    Plan as Plan,
    Tree as Tree,
    clear as clear,
    empty_factor as empty_factor,
    plan as plan,
    plan_stack as plan_stack,
    round_up as round_up,
    tree_of as tree_of,
)
from .threads import (
    Teamwork as Teamwork,
    alone as alone,
    open_agenda as open_agenda,
    usable_threads as usable_threads,
)
