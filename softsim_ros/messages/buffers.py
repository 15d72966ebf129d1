"""NumPy arrays as the buffers that message fields take without a look at each element."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_TYPECODES: dict[str, Any] = {"d": np.dtype("<f8"), "f": np.dtype("<f4"), "I": np.dtype("<u4")}


def message_array(values: ArrayLike, typecode: str) -> array[Any]:
    """Values as the `array.array` of a message field.

    Args:
        values: Numbers of any shape; taken row by row.
        typecode: "d" (float64), "f" (float32), "I" (uint32) or "B" (raw bytes of the values as they are).

    Returns:
        A copy of the numbers; for "B" a copy of their memory, little-endian where the input is.
    """
    numbers = np.asarray(values, dtype=_TYPECODES.get(typecode))
    buffer: array[Any] = array(typecode)
    buffer.frombytes(numbers.tobytes())
    return buffer
