"""From raw antenna traces to background spectra (section 3.1 of the paper).

Read `trace` (what a trace is), `frames` and `hdf5` (its two file formats), `discovery` (files to station events),
`density` (blocks to spectra), `blocks` (one pass over the samples), `selection` (which blocks), `interference` (which
channels), `background` (all of it), `anomalies` (which events), `inspection` (one trace, drawn).
"""
