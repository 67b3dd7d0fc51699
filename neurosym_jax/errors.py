"""The one exception that means "your input, not our code": scripts print it as a single line."""

__all__ = ["InputError"]


class InputError(ValueError):
    """Something a user gave cannot be used; the message names the file, the row and the reason."""
