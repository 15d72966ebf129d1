"""Bags: `record`, `replay`, `export`, `report`."""
