"""Antenna models: read `model`, `hamaker`, `names`, `files`, `varied`, `circuit`, `unfolding`."""
