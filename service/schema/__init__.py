"""The tables; read `tables`, then `drift`. Their history is in `migrations/`."""
