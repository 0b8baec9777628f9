"""The signal chain of eq. full_chain: read `model`."""
