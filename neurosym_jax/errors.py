"""Errors and warnings about a user's input; commands print each as a single line."""

__all__ = ["InputError", "InputWarning", "TrainingError", "printable"]


class InputError(ValueError):
    """Input that cannot be used; the message names the file, the row and the reason."""


class InputWarning(UserWarning):
    """Input that can be used but looks wrong; the message names the file."""


class TrainingError(InputError):
    """Training cannot continue or be resumed; saved states are kept."""


def printable(text: str) -> str:
    """Foreign text with characters escaped that would steer a terminal or cannot be written."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )
