"""The one error that is the user's to mend."""


class BadInput(ValueError):
    """Input that cannot be used: the message says what, where, and what to do.

    The command line prints it on one line and exits with code 2.
    """
