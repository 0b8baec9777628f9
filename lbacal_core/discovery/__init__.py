"""What the simulation gets wrong: read `search` and `growth`, then `view`, `project`, `scan` and `refit`."""
