"""P_sky(LST, nu): read `model`, then `modes` (the Fourier series) and `direct` (the plain sum it is tested against).

`variation` changes the beam, `sources` adds point sources, `differences` holds how far models differ, `table` is the
value and its file.
"""
