"""Claims that need many data sets, kills or years; `./dev prove NAME` runs one.

A proof is a module here with a tuple `PARTS`; read `proofs/machinery/parts.py`, then `proofs/twin.py` for a short one.
"""
