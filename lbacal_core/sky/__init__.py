"""Sky models: read `model` (what one is), `names`, `maps`, `sources` (where they come from), `frames`, `multipoles`."""
