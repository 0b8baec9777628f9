"""Instants on the wire: the server reads and writes them as the client does."""

from lbacal.instants import DAY_US, format_instant, format_optional, parse_at, parse_instant

__all__ = ["DAY_US", "format_instant", "format_optional", "parse_at", "parse_instant"]
