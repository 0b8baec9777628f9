"""Background spectra: read `spectra`, then `screening` and `blocks`."""
