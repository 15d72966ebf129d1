"""Array type names used in signatures."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""float64 array; its shape and unit stand in the docstring beside it."""

IndexArray: TypeAlias = NDArray[np.int64]
"""int64 array of indices, 0-based."""

BoolArray: TypeAlias = NDArray[np.bool_]
"""Array of flags."""
