"""`python -m simgen.cli` is the command `simgen`."""

from simgen.cli.app import main

main()
