from .layouts import (
    CONTROLLER as CONTROLLER,
    GOAL_TIME as GOAL_TIME,
    GOAL_TOLERANCE as GOAL_TOLERANCE,
    SHOWN as SHOWN,
    companions as companions,
    controllers as controllers,
    rviz_config as rviz_config,
    write_folder as write_folder,
)
from .links import (
    Link as Link,
    links_of as links_of,
    moved_link as moved_link,
)
from .urdf_model import (
    control_topics as control_topics,
    mesh_address as mesh_address,
    urdf as urdf,
)
