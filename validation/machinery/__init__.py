"""How a proof is run, judged and kept: read claims, seeds, parts, trials, records, then page."""
