from .filter import (
    WINDOWS as WINDOWS,
    JumpDetector as JumpDetector,
    StateEstimate as StateEstimate,
    chi_square_limit as chi_square_limit,
    squared_distance as squared_distance,
)
from .observer import Observer as Observer
from .sensors import (
    Sensor as Sensor,
    effector_sensor as effector_sensor,
    field_rows as field_rows,
    marker_sensors as marker_sensors,
    point_rows as point_rows,
)
from .settings import (
    Estimate as Estimate,
    ObserverSettings as ObserverSettings,
)
