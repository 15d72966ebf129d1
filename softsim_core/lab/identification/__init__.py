"""A model and measurements: described data sets, replay of their commands, alignment of sensors, errors."""

from __future__ import annotations

from softsim_core.lab.identification.files import DataSet, known_data_sets, load_data_set
from softsim_core.lab.identification.session import Session, load_session

__all__ = ["DataSet", "Session", "known_data_sets", "load_data_set", "load_session"]
