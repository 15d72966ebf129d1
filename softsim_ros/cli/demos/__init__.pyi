from .grasp import GraspResult as GraspResult
from .pick_and_place import (
    AWAY as AWAY,
    MeasuredObject as MeasuredObject,
    objects_of as objects_of,
    way_of as way_of,
)
