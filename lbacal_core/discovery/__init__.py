"""What the simulation gets wrong: read `search`, then `view`, `project`, `scan`, `refit` and `residual_structure`.

`free_vectors` and `view` hold the one formula, `project` adds it up for a station.
"""
