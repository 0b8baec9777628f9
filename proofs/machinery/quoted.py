"""Figures of the records that README and explanations quote; `./dev prove` renews them."""

from __future__ import annotations

from proofs.machinery.quotes import Quote

QUOTES: tuple[Quote, ...] = ()
