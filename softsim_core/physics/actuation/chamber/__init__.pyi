from .chamber import (
    Chamber as Chamber,
    ChamberView as ChamberView,
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
