from . import environment as environment
from .background import (
    BackgroundWorker as BackgroundWorker,
    WorkQueue as WorkQueue,
)
from .environment import (
    BOOTSTRAP_MARK as BOOTSTRAP_MARK,
    check_ros_variables as check_ros_variables,
    has_ros_wheels as has_ros_wheels,
    prepare_environment as prepare_environment,
    ros_problems as ros_problems,
    system_ros as system_ros,
)
from .frames import (
    BASE_LINK as BASE_LINK,
    EFFECTOR as EFFECTOR,
    WORLD as WORLD,
    RobotFrames as RobotFrames,
    prefix_of as prefix_of,
)
from .guards import (
    REFUSAL_PERIOD_S as REFUSAL_PERIOD_S,
    GuardedNode as GuardedNode,
    Refusals as Refusals,
    message_door as message_door,
    parameter_door as parameter_door,
    service_door as service_door,
)
from .parameters import (
    About as About,
    LiveParameters as LiveParameters,
    ParameterError as ParameterError,
    Program as Program,
    checked as checked,
    declare as declare,
    declare_value as declare_value,
    described as described,
    parameter as parameter,
    parameter_probe as parameter_probe,
)
from .process import (
    keep_freed_memory as keep_freed_memory,
    ready_callbacks as ready_callbacks,
    ros_process as ros_process,
    run_node as run_node,
    serve_callbacks as serve_callbacks,
    serve_once as serve_once,
    spin as spin,
)
from .program import run_module as run_module
from .signals import (
    END_SIGNALS as END_SIGNALS,
    Ending as Ending,
    ending as ending,
)
from .text import (
    LONGEST_SENTENCE as LONGEST_SENTENCE,
    named as named,
    one_line as one_line,
    printable as printable,
    sentence as sentence,
    sentence_of as sentence_of,
    shortened as shortened,
    takes_escapes as takes_escapes,
)
from .topics import (
    EVERY_ONE as EVERY_ONE,
    LATCHED as LATCHED,
    MEASURED as MEASURED,
    NEWEST_ONLY as NEWEST_ONLY,
    STATE_QOS as STATE_QOS,
    STATE_TOPICS as STATE_TOPICS,
    Facts as Facts,
    StateTopics as StateTopics,
    hearing_all as hearing_all,
    latched as latched,
)
