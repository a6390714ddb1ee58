"""The one exception a user sees: a sentence that says what is wrong, where, and what mends it."""


class DefplanError(Exception):
    """An error with a message written for the user; the command line prints it without a traceback."""
