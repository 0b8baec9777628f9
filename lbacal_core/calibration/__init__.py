"""From spectra to C(nu): read `fit`, then `lines`, `noise` and `separable`."""
