from .bodies import (
    SHEAR_SHARE as SHEAR_SHARE,
    Body as Body,
)
from .builder import (
    BuiltScene as BuiltScene,
    build as build,
    chosen_nodes as chosen_nodes,
    on_a_line as on_a_line,
    rest_bodies as rest_bodies,
    sensors as sensors,
    surroundings as surroundings,
    with_rest_frames as with_rest_frames,
)
from .contact_builder import (
    RigidBody as RigidBody,
    contacts as contacts,
    need_apart as need_apart,
    rigid_objects as rigid_objects,
    triangles_in as triangles_in,
    triangles_in_boxes as triangles_in_boxes,
)
