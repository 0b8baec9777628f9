"""Reports and scores of fixed data sets, kept as numbers: a restructured discovery must reproduce them.

Read `listing` (which data sets), `data_sets` (how each is made), `surface` (which numbers are taken, the one file that
knows the names inside `lbacal_core.discovery`), `comparison` (what counts as different), `__main__` (the command).
"""
