"""How the calibration of a path changes with time: `monthly` measures it, `steps` finds where it jumps."""
