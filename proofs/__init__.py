"""Claims that need many data sets, kills or years; `./dev prove NAME` runs one."""
