from .bridge import (
    ABOVE_RAD as ABOVE_RAD,
    BELOW_RAD as BELOW_RAD,
    BridgeFigures as BridgeFigures,
    Crossing as Crossing,
    latencies as latencies,
    measure_bridge as measure_bridge,
)
from .command import (
    SCENES as SCENES,
)
from .copies import (
    BatchRate as BatchRate,
    EnvironmentCost as EnvironmentCost,
    cost_table as cost_table,
    describe_missed_targets as describe_missed_targets,
    measure_copies as measure_copies,
    measure_environments as measure_environments,
    measure_peer as measure_peer,
    rate_table as rate_table,
)
from .first_start import (
    KERNELS as KERNELS,
    MOTION as MOTION,
    FirstStart as FirstStart,
    compare_with_targets as compare_with_targets,
)
from .measured_scenes import (
    LIMITS as LIMITS,
    TOUCHING as TOUCHING,
    Case as Case,
    TouchingScene as TouchingScene,
    default_reference_dir as default_reference_dir,
    describe as describe,
)
from .process import (
    resident_mb as resident_mb,
)
from .records import (
    Record as Record,
    peer_table as peer_table,
    reference_size as reference_size,
    set_ratios as set_ratios,
    table as table,
    write_json as write_json,
)
from .rubber import (
    measure_rubber as measure_rubber,
    rubber_table as rubber_table,
)
from .scaling import (
    SIZES as SIZES,
    Scale as Scale,
    clamped_scene as clamped_scene,
    measure_scaling as measure_scaling,
    mesh_of as mesh_of,
    scaling_table as scaling_table,
)
from .sensing import (
    ALL as ALL,
    LIMIT_MS as LIMIT_MS,
    measure_sensors as measure_sensors,
    sensor_table as sensor_table,
)
from .steps import (
    FALL_STEPS as FALL_STEPS,
    STEPS_A_TURN as STEPS_A_TURN,
    Probe as Probe,
    can_control as can_control,
    known_paths as known_paths,
)
