"""The commands of the server, which join those of `lbacal.cli`: read `main`."""
