"""How far C may be off: `refit` (what may be wrong, and what that does to C), `one_event`."""
