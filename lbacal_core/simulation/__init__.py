"""The simulation: an instrument under a sky, and by how much each of its parts may be wrong."""
