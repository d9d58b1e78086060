"""The command line: all commands and console views. No other package imports typer or rich."""
