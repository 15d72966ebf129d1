from .environments import (
    RobotEnv as RobotEnv,
    RobotVectorEnv as RobotVectorEnv,
)
from .episodes import Episodes as Episodes
from .policy import (
    Policy as Policy,
    load_policy as load_policy,
    objection as objection,
    policy_metadata as policy_metadata,
)
from .randomisation import (
    Delay as Delay,
    Devices as Devices,
    RandomisationDescription as RandomisationDescription,
    SpreadDescription as SpreadDescription,
    load_randomisation as load_randomisation,
    round_to_steps as round_to_steps,
)
from .tasks import (
    REACHED_M as REACHED_M,
    TASKS as TASKS,
    Moment as Moment,
    Senses as Senses,
)
