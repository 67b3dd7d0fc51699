"""The site's notebooks run, and show what is kept in them."""

import pytest

from studies.notebooks import FOLDER, execute

DOWNLOADED = {"an_overtaking_ahead_of_time": "eth-ucy"}
"""Notebooks of real recordings, and the collection that they are of."""
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))


def kinds(notebook):
    """Of the outputs, cell by cell: pictures and text."""
    return [
        ["image" if "image/png" in one.get("data", {}) else "text" for one in cell.outputs]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name, request, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat", reason="notebooks need the extra test")
    pytest.importorskip("ipykernel", reason="notebooks need the extra test")
    if collection := DOWNLOADED.get(name):
        data = request.getfixturevalue("shared") / "data" / collection.replace("-", "_")
        (tmp_path / collection).symlink_to(data)
        monkeypatch.setenv("NEUROSYM_DATA", str(tmp_path))
    kept = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    assert ["image"] in kinds(kept)
    assert kinds(execute(FOLDER / f"{name}.ipynb")) == kinds(kept)
