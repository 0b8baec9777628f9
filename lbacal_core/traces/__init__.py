"""From raw antenna traces to background spectra (section 3.1 of the paper).

Read `trace` (what a trace is, and its file formats), `density` (blocks to spectra, and which channels), `selection`
(which blocks), `background` (all of it), `assembly` (many events), `inspection` (one trace, drawn).
"""
