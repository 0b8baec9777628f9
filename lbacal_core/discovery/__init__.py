"""What the simulation gets wrong: read `investigate`, then `baseline`, `whitening`, `scan` and `leftover`."""
