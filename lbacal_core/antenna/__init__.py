"""Antenna models: read `model` (what one answers), `hamaker`, `table` and `files`, `varied`, `circuit`, `effective`."""
