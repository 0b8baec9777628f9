"""The tables; read `tables`. Their history is in `migrations/`."""
