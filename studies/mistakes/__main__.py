"""Print what happens to each mistake.

python -m studies.mistakes
"""

import itertools
import tempfile
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data import ReadOptions, windows_from
from neurosym_jax.errors import InputError, InputWarning
from studies.mistakes.corpus import MISTAKES, Mistake
from studies.mistakes.crowd import text


def tell(mistake: Mistake, folder: Path) -> tuple[str, str]:
    """What happens to a mistake, in `folder`, and what is said."""
    path, content = folder / "mine.txt", mistake.content
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        try:
            windows = windows_from(path, 4, 4, read=ReadOptions(**mistake.options))
        except InputError as error:
            return "refused", str(error).removeprefix(f"{path}: ")
    messages = list(itertools.chain(*(item.warnings for item in windows.reading)))
    if len(messages) != len(caught):
        return "silent", f"warnings {caught}, in the report {messages}"
    if messages:
        return "warned", messages[0]
    shapes, truth = _shapes(windows), _shapes(windows_from(_truth(folder), 4, 4))
    same = sum((shapes & truth).values())
    filled = sum(reading.filled for reading in windows.reading)
    if same < 0.8 * sum(truth.values()) and filled == 0:
        return "silent", f"{same} of {sum(truth.values())} windows"
    return "read", f"{same} windows" + f", {filled} points filled" * (filled > 0)


def _truth(folder: Path) -> Path:
    path = folder / "truth.txt"
    path.write_text(text())
    return path


def _shapes(windows: Any) -> Counter[bytes]:
    """How often each sequence of moves occurs."""
    return Counter(
        way.round(2).tobytes() for way in np.diff(windows.position, axis=1) + 0.0
    )


def main() -> None:
    """Print the table."""
    print("| mistake | must be | is | said |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for mistake in MISTAKES:
            outcome, message = tell(mistake, Path(folder))
            print(
                f"| {mistake.name} | {mistake.outcome} | {outcome} | {message[:120]} |"
            )


if __name__ == "__main__":
    main()
