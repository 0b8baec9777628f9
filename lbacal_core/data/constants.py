"""Physical constants: those that the SI fixes, and the CODATA values of 2022 of those that are measured.

They are those of scipy.constants, which takes a fifth of a second to import, in every command.
"""

from __future__ import annotations

BOLTZMANN = 1.380649e-23
"""k_B, J/K."""
SPEED_OF_LIGHT = 299792458.0
"""c, m/s."""
VACUUM_PERMEABILITY = 1.25663706127e-06
"""mu_0, N/A^2."""
VACUUM_PERMITTIVITY = 8.8541878188e-12
"""epsilon_0, F/m."""
IMPEDANCE_OF_FREE_SPACE = VACUUM_PERMEABILITY * SPEED_OF_LIGHT
"""Z_0, ohm."""
