"""P_sky(LST, nu): read `table` (the value and its file), then `direct` (the plain sum over the sky)."""
