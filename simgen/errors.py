"""The one exception that a user is meant to read."""


class InputError(ValueError):
    """Bad input. The message is one line: the file, the key, the value and what is allowed.

    The command line prints it and exits with code 2; from Python it is an ordinary ``ValueError``.
    """
