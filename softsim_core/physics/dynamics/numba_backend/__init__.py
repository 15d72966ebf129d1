"""The compiled time step. Only this package needs Numba."""
