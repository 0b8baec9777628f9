"""Effects hidden in simulated data, and what is found: data_sets, ideal, sizes, finder, then one file a question."""
