"""The page: templates, style, plots and the vendored chart library. `assets` serves files, `render` fills templates."""
