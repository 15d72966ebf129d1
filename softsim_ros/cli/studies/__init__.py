"""Many runs of one scene: `sweep`, `optimise`."""
