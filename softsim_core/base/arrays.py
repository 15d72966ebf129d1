"""Array type names for signatures, and validation of arrays from users."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from softsim_core.base.errors import ArrayError

Array: TypeAlias = NDArray[np.float64]
"""float64 array; its shape and unit are given in the docstring."""

IndexArray: TypeAlias = NDArray[np.int64]
"""int64 array of indices, 0-based."""

BoolArray: TypeAlias = NDArray[np.bool_]
"""Array of booleans."""

_FLOAT64 = np.dtype(np.float64)


def float_array(value: object, shape: tuple[int, ...], name: str) -> Array:
    """Return `value` as a C-contiguous float64 array; it is copied only if necessary.

    Raises:
        ArrayError: not of the required shape, where -1 is any length, or not real numbers; gives the name.
    """
    if type(value) is np.ndarray and value.dtype is _FLOAT64 and value.flags.c_contiguous:
        array: Array = value
    else:
        try:
            numbers = np.asarray(value)
            if numbers.dtype.kind not in "biuf":
                raise TypeError
            array = np.array(numbers, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise ArrayError(name, shape, "something that is no array of real numbers") from error
    if array.shape != shape:
        pairs = zip(shape, array.shape, strict=False)
        if array.ndim != len(shape) or any(want not in (-1, have) for want, have in pairs):
            raise ArrayError(name, shape, f"shape {array.shape}")
    return array


def unique_pairs(pairs: IndexArray) -> IndexArray:
    """Return the distinct rows of `pairs` (k, 2), numbers >= 0, in ascending order, shape (u, 2)."""
    span = int(pairs[:, 1].max(initial=0)) + 1
    return np.stack(np.divmod(np.unique(pairs[:, 0] * span + pairs[:, 1]), span), axis=1)
