"""P_sky(LST, nu): read `model`, then `modes` (the Fourier series) and `direct` (the plain sum it is tested against)."""
