from .folder import (
    CONTROLLER as CONTROLLER,
    GOAL_TIME as GOAL_TIME,
    GOAL_TOLERANCE as GOAL_TOLERANCE,
    companions as companions,
    controllers as controllers,
    write_folder as write_folder,
)
from .layouts import (
    SHOWN as SHOWN,
    rviz_config as rviz_config,
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
