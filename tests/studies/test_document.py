"""A report as Markdown."""

from studies.experiment.document import Document


def test_markdown(tmp_path):
    document = Document("A < B", tmp_path)
    document.heading("Part")
    document.text("Some **bold** words\n  and `a < b`.")
    document.code("python -m x\nls")
    document.table("Numbers", ["Name", "Value"], [["a/b", "1.5"], ["c", "–"]])
    document.figure(tmp_path / "figures" / "a.png", "What is seen")
    markdown = document.markdown()
    assert markdown.startswith("# A < B\n\n## Part\n\nSome **bold** words and `a < b`.\n")
    assert "\n    python -m x\n    ls\n" in markdown
    assert "| Name | Value |\n| --- | ---: |\n| a/b | 1.5 |\n| c | – |\n" in markdown
    assert "![What is seen](figures/a.png)" in markdown
