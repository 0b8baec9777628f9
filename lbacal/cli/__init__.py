"""The command `lbacal`: read `main`."""
