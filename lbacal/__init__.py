"""The public face: the calibration in effect, and what a pipeline needs to send spectra."""
