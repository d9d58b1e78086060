"""The command line: every command and every view on the console. Nothing else imports typer or rich."""
