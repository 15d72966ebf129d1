from .drive import (
    SPEED as SPEED,
    check_values as check_values,
    rotation_from as rotation_from,
)
from .scene_state import SceneState as SceneState
from .simulation import Simulation as Simulation
from .warmup import (
    cached_kernels as cached_kernels,
    get_ready_to_load as get_ready_to_load,
    kernels_ready as kernels_ready,
    small_scene as small_scene,
    touching_scene as touching_scene,
    warm_up as warm_up,
)
