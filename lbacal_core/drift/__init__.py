"""How calibrations change with time.

Read `events` (what one event tells of a path), `monthly` (its mean in a month), `terms` and `noise` (offset, season,
slope, steps, and the covariance of months), `dates`, `search` (which terms a path has), `whole` (what all paths share)
and `follow`, which asks all of them about an array.
"""
