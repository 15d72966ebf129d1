from .body import clamped_body as clamped_body
from .comparison import compare as compare
from .drake_body import DrakeBody as DrakeBody
from .mjcf_comparison import (
    LAWS as LAWS,
    ModelComparison as ModelComparison,
    compare_model as compare_model,
)
