"""P_sky(LST, nu): read `model`, then `modes` (the Fourier series) and `direct` (the plain sum it is tested against).

`sources` adds point sources, `differences` and `sky_terms` say how far models differ, `table` is value and file.
"""
