"""Other people's data into background spectra: read `source`, `average`, then a file a format."""
