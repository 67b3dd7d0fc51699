"""Draw the figures of docs/evaluate.md that Python draws: `python -m studies.gallery DATA`.

DATA is ETH/UCY (`neurosym download eth-ucy`). What runs is the page's own code; seeds
are 0.
"""

import re
import sys
from pathlib import Path
from typing import Any
from unittest import mock

from PIL import Image

from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.plotting import save_figure

__all__ = ["draw"]

DOCS = Path(__file__).resolve().parents[1] / "docs"
CODE = re.compile(r"(?:\(figures/(\w+)\.png\)\n\n)?```python\n(.*?)```", re.DOTALL)
"""Code, and the name of the figure above it; the first code begins all others."""
WIDE = 1300
"""Most dots of a figure's width."""


def draw(data: str, folder: Path = DOCS / "figures") -> list[Path]:
    """Draw the figures of the page into `folder`."""
    page = (DOCS / "evaluate.md").read_text()
    section = page.split("\n## Figures\n")[1].replace('"eth-ucy"', repr(data))
    (_, start), *figures = CODE.findall(section)
    paths = []
    for name, code in figures:
        names: dict[str, Any] = {}
        with mock.patch.dict(METRICS):
            exec(start + code, names)
        path = save_figure(names["figure"], folder / f"{name}.png")
        image = Image.open(path).convert("RGB")
        image.thumbnail((WIDE, 2 * WIDE))
        image.quantize(dither=Image.Dither.NONE).save(path, optimize=True)
        paths.append(path)
    return paths


if __name__ == "__main__":
    print(*draw(sys.argv[1]), sep="\n")
