"""How calibrations change with time.

Read `events` (what one event says of a path, and its mean in a month), `model` (offset, season, slope, steps, and the
covariance of months), `search` (which terms a path has) and `follow`, which asks all of them about an array.
"""
