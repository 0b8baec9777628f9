"""From spectra to C(nu): read `fit`, then `lines`, `separable`, `paths` and `chain_test`.

`budget` says how far C may be off, `one_event` how far that of one event.
"""
