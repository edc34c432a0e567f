"""The one error a user causes and a user can mend."""


class BadInput(Exception):
    """One line that names the file or key, what is wrong there, and what was expected. Commands exit with 2."""
