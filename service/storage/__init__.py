"""All SQL. `database` opens transactions; the stores turn rows into values and back; rows never leave this package."""
