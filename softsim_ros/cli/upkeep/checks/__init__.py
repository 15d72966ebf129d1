"""The checks of `softsim doctor`: each a function that returns its findings."""
