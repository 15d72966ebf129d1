"""The observer as a node: sensors in, shape and contact out."""
