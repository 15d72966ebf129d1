from .chamber import (
    Chamber as Chamber,
    ChamberView as ChamberView,
    closed_hollow as closed_hollow,
)
from .chambers import (
    CHAMBER as CHAMBER,
    ChamberArrays as ChamberArrays,
    Chambers as Chambers,
)
from .description import (
    ATMOSPHERE as ATMOSPHERE,
    ChamberDescription as ChamberDescription,
)
