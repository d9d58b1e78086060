"""Run the command `simgen` by ``python -m simgen.cli``."""

from simgen.cli.app import main

main()
