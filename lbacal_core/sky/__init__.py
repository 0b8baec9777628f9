"""The Galaxy, and P_sky(LST, nu), what an antenna receives of it.

Read `model` (what a sky model is), `names` and `maps` (where they come from); then `power`, `modes` (the Fourier
series) and `direct` (the plain sum it is tested against). `sources` adds point sources, `differences` and `sky_terms`
say how far models differ, `table` is value and file.
"""
