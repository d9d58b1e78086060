"""Start Warp without a word: neither its greeting, nor a warning on every machine that has no GPU."""

import os

import warp as wp


def start_warp() -> None:
    """Initialise Warp; harmless when it is already.

    Its native code writes the warning to file descriptor 2 before any setting of Warp's is read.
    """
    wp.config.log_level = wp.LOG_WARNING
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
