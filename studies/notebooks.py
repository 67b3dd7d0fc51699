"""Run the site's notebooks anew and keep what they print and draw.

    python -m studies.notebooks [NAME ...]

runs `docs/notebooks/NAME.ipynb`, by default all, each in a process of its own, and
writes their outputs into them. Needs the extra `test`.
"""

import sys
from pathlib import Path
from typing import Any

from neurosym_jax.runtime.files import write_text

__all__ = ["FOLDER", "execute"]

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"


def execute(path: Path) -> Any:
    """The notebook at `path` after all of its cells have run.

    Raises:
        nbclient.exceptions.CellExecutionError: for a cell that fails.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    options = {"timeout": 600, "record_timing": False, "coalesce_streams": True}
    NotebookClient(notebook, **options).execute(cwd=str(path.parent))
    for cell in notebook.cells:
        # Progress is for who waits.
        if cell.cell_type == "code":
            cell.outputs = [
                output for output in cell.outputs if output.get("name") != "stderr"
            ]
    notebook.metadata.language_info = {
        "name": "python"
    }  # Without this machine's version.
    return notebook


if __name__ == "__main__":
    import nbformat

    names = sys.argv[1:] or sorted(path.stem for path in FOLDER.glob("*.ipynb"))
    for chosen in (FOLDER / f"{name}.ipynb" for name in names):
        write_text(chosen, nbformat.writes(execute(chosen)) + "\n")
        print(chosen)
