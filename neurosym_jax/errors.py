"""Errors and warnings about a user's input; commands print each as a single line."""

import reprlib

__all__ = ["InputError", "InputWarning", "TrainingError", "brief", "printable"]


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


class _Brief(reprlib.Repr):
    """A `repr` that takes little time whatever the value: foreign lists may share parts."""

    def __init__(self):
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, 80, 120

    def repr_int(self, x: int, level: int) -> str:
        return f"an integer of {x.bit_length()} bits" if x.bit_length() > 128 else repr(x)

    def repr_instance(self, x: object, level: int) -> str:
        return self.repr_dict(x, level) if isinstance(x, dict) else super().repr_instance(x, level)


brief = _Brief().repr
"""The `repr` of a foreign value, of its first 80 to 120 letters, for a message."""
