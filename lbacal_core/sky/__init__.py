"""Sky models: read `model` (what one is), `names`, `maps` and `sources` (where they come from)."""
