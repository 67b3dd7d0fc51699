"""The exceptions that mean "your input, not our code": scripts print them as a single line."""

__all__ = ["InputError", "TrainingError"]


class InputError(ValueError):
    """Something a user gave cannot be used; the message names the file, the row and the reason."""


class TrainingError(InputError):
    """Training cannot go on or be resumed; what was saved before is kept."""
