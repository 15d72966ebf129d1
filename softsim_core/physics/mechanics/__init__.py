"""Generalised coordinates: free nodes, rigid frames, joints."""
