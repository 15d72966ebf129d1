from .measure import (
    Looks as Looks,
    Measurement as Measurement,
    SetFolder as SetFolder,
)
from .player import (
    MeasurementInterruptedError as MeasurementInterruptedError,
    Player as Player,
)
from .readings import (
    drifts as drifts,
    not_before as not_before,
    rings_from as rings_from,
    times_of as times_of,
)
from .sensors import (
    IMU as IMU,
    SIMULATED as SIMULATED,
    ExcitationError as ExcitationError,
    Sensor as Sensor,
    SensorChoice as SensorChoice,
    sensor_choice as sensor_choice,
    subscribe_sensors as subscribe_sensors,
)
