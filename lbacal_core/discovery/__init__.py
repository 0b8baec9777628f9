"""What the simulation gets wrong: read `search`, then `view`, `project`, `scan`, `refit` and `residual_structure`."""
