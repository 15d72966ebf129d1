from .actuators import (
    CableSensorDescription as CableSensorDescription,
    ChamberSensorDescription as ChamberSensorDescription,
)
from .description import (
    ANY_BODY as ANY_BODY,
    PLACE as PLACE,
    SOFT_BODY as SOFT_BODY,
    Mount as Mount,
    Output as Output,
    Quantity as Quantity,
    Reference as Reference,
    Scenery as Scenery,
    SimulatedSensorDescription as SimulatedSensorDescription,
    need_sensors as need_sensors,
)
from .force_torque import ForceTorqueDescription as ForceTorqueDescription
from .imu import (
    ImuDescription as ImuDescription,
    inertial as inertial,
)
from .markers import (
    MarkersDescription as MarkersDescription,
    StrainSensorDescription as StrainSensorDescription,
)
from .sensor import (
    Place as Place,
    Sensor as Sensor,
    StepObservation as StepObservation,
)
from .sensors import (
    SensorReading as SensorReading,
    Sensors as Sensors,
    register_sensor as register_sensor,
    sensor_kind as sensor_kind,
    sensor_kinds as sensor_kinds,
)
from .tactile import (
    TactileArrayDescription as TactileArrayDescription,
    grid_over as grid_over,
    spread_over as spread_over,
)
from .wrench import WrenchSensorDescription as WrenchSensorDescription
