"""Calibration curves C(nu): read `curves`, then `covariance`, `reference_chain` and `validity` (what is in effect)."""
