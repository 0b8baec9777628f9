"""`./dev demo`: the mission in half a minute; `__main__` tells it, `service_run` runs the service beside it."""
