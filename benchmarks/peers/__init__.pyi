from .body import clamped_body as clamped_body
from .comparison import compare as compare
from .drake_body import DrakeBody as DrakeBody
