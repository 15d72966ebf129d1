"""Models beside robots: identification, studies, learning, meshes of parts."""
