"""`python -m lbacal` is the command `lbacal`."""

from lbacal.cli.main import main

main()
