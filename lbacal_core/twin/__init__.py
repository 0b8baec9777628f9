"""The twin: simulated campaigns with a sealed truth; knows nothing of what searches them."""
