from .cell import (
    Element as Element,
    ElementData as ElementData,
    cell_axes as cell_axes,
    rest_quadrature as rest_quadrature,
)
from .registry import (
    element as element,
    element_names as element_names,
    element_of_kind as element_of_kind,
    register_element as register_element,
)
from .solid import (
    MIDDLES as MIDDLES,
    TET10 as TET10,
)
from .surface import (
    TRI3 as TRI3,
    TRI6 as TRI6,
    surface_quadrature as surface_quadrature,
)
