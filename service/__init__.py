"""Keeping, scheduling and serving; computes nothing that belongs in a paper."""
