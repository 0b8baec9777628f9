"""What stands in the field: read `instrument`, then `antennas` and `stages`."""
