"""Band-averaged power against sidereal time, as published of the real instrument: read `curve`, then `compare`."""
