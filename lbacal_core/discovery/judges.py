"""The two judges of what a simulation gets wrong, and the one that is asked."""

from typing import Literal

Judge = Literal["search", "compete"]
"""*search* names the causes that chance does not explain, *compete* those that no sentence explains better."""
JUDGES: tuple[Judge, ...] = ("search", "compete")
DEFAULT_JUDGE: Judge = "search"
