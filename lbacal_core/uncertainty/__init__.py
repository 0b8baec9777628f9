"""How far C may be off beside its statistical error: what may be wrong (`changes`), what that does to C (`refit`)."""
