from .mesh import fitness as fitness
from .mesh_speed import clamped_part as clamped_part
from .mjcf_comparison import compare_model as compare_model
from .new import (
    arm_text as arm_text,
    inlet_notes as inlet_notes,
    number as number,
    scene_text as scene_text,
)
