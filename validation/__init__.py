"""Claims that need many data sets, kills or years; `./dev prove NAME` runs one.

A proof is a module here with a tuple `PARTS`; read `validation/machinery/parts.py`, then `validation/twin.py` for a
short one. `benchmarks` state speed, `scripts` make the tables that ship and the figures of the docs.
"""
