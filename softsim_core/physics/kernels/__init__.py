"""Kernels compiled by Numba: how, by whom, and where they are cached."""

from __future__ import annotations

from softsim_core.physics.kernels.compiler import Compiler, OneSignature, why_plain

__all__ = ["Compiler", "OneSignature", "why_plain"]
