"""What stands in the field: read `instrument`, then `antennas`, `stages` and `chain` (eq. full_chain)."""
