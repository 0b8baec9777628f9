"""The twin: simulated campaigns with a sealed truth; knows nothing of what searches them.

Read `settings`, `stages`, `hardware`, `campaign`, then `fault` and what is built on it.
"""
