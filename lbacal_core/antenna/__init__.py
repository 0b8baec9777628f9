"""Antenna models: the directional response of a dipole and its gain."""
