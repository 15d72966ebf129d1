"""Commands for bags: `record`, `replay`, `export`, `report`."""
