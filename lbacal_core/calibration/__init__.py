"""From spectra to C(nu): read `fit`, then `lines`, `separable`, `paths` and `chain_test`."""
