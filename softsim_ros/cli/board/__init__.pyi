from .flash import (
    flash_command as flash_command,
    is_as_recorded as is_as_recorded,
)
