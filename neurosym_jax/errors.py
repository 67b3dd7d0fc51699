"""What means "your input, not our code": commands print each as a single line."""

__all__ = ["InputError", "InputWarning", "TrainingError", "printable"]


class InputError(ValueError):
    """Something a user gave cannot be used; the message names the file, the row and the reason."""


class InputWarning(UserWarning):
    """Something a user gave can be used but looks wrong; the message names the file."""


class TrainingError(InputError):
    """Training cannot go on or be resumed; what was saved before is kept."""


def printable(text: str) -> str:
    """Text from outside, with what would steer a terminal, or cannot be written, escaped."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )
