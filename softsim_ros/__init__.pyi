from .launch_plan import (
    LaunchArguments as LaunchArguments,
    Plan as Plan,
    PlannedNode as PlannedNode,
    board_link as board_link,
    plan as plan,
)
from .listeners import (
    JointReader as JointReader,
    JointStates as JointStates,
    StateListener as StateListener,
)
from .optional_messages import (
    OPTIONAL as OPTIONAL,
    optional_module as optional_module,
    optional_type as optional_type,
)
from .report_pages import (
    figure_data as figure_data,
    render_page as render_page,
    save_figure as save_figure,
    write_page as write_page,
)
from .robot_node import (
    FrameSettings as FrameSettings,
    RobotNode as RobotNode,
    RobotSettings as RobotSettings,
    SpinThread as SpinThread,
)
from .topic_names import (
    chamber_topics as chamber_topics,
    chambers_of as chambers_of,
    topic_words as topic_words,
)
