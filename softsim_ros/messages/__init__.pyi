from .markers import (
    MarkerTemplate as MarkerTemplate,
    MovingMarkers as MovingMarkers,
)
from .meshes import (
    colour_table as colour_table,
    linear_rgb as linear_rgb,
    mesh_checksum as mesh_checksum,
    point_cloud as point_cloud,
    read_point_cloud as read_point_cloud,
    stress_colours as stress_colours,
    topology as topology,
)
from .scene import (
    MOST_POINTS as MOST_POINTS,
    ChosenPoints as ChosenPoints,
    Proposal as Proposal,
    SceneMessage as SceneMessage,
    read_edits as read_edits,
    read_proposal as read_proposal,
    read_scene_message as read_scene_message,
    write_edits as write_edits,
    write_proposal as write_proposal,
)
from .sensors import (
    TENSION as TENSION,
    SensorMessage as SensorMessage,
    contact_cloud as contact_cloud,
    messages_of as messages_of,
    read_contact_cloud as read_contact_cloud,
    read_step_profile as read_step_profile,
    read_tension_cloud as read_tension_cloud,
    step_profile as step_profile,
    tension_cloud as tension_cloud,
)
from .states import (
    base_target as base_target,
    clock as clock,
    header as header,
    joint_state as joint_state,
    message_array as message_array,
    pose as pose,
    pose_stamped as pose_stamped,
    read_base_target as read_base_target,
    time_message as time_message,
    transform_stamped as transform_stamped,
)
from .types import (
    ERROR as ERROR,
    OK as OK,
    WARN as WARN,
    diagnostic_array as diagnostic_array,
    format_value as format_value,
    load_message as load_message,
)
