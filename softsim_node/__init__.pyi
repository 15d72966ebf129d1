from . import environment as environment
from .background import (
    BackgroundWorker as BackgroundWorker,
    OwnerThread as OwnerThread,
    WorkQueue as WorkQueue,
    in_thread as in_thread,
)
from .environment import (
    BOOTSTRAP_MARK as BOOTSTRAP_MARK,
    check_ros_variables as check_ros_variables,
    has_ros_wheels as has_ros_wheels,
    limit_blas_threads as limit_blas_threads,
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
    answering as answering,
    guard_parameters as guard_parameters,
    guard_service as guard_service,
    guard_subscription as guard_subscription,
    steady_timer as steady_timer,
)
from .parameters import (
    LiveParameters as LiveParameters,
    ParameterChanges as ParameterChanges,
    ParameterError as ParameterError,
    ParameterInfo as ParameterInfo,
    Program as Program,
    check_value as check_value,
    declare as declare,
    declare_value as declare_value,
    parameter as parameter,
    parameter_probe as parameter_probe,
    parameters_of as parameters_of,
)
from .process import (
    ready_callbacks as ready_callbacks,
    reuse_freed_memory as reuse_freed_memory,
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
    LONGEST_MESSAGE as LONGEST_MESSAGE,
    error_message as error_message,
    error_text as error_text,
    list_names as list_names,
    one_line as one_line,
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
    latched_qos as latched_qos,
    matching_qos as matching_qos,
)
