"""A report says the same as Markdown and as HTML, and needs nothing beside it."""

from studies.experiment.document import Document


def test_the_same_in_both(tmp_path):
    image = tmp_path / "figures" / "a.png"
    image.parent.mkdir()
    image.write_bytes(b"png")
    document = Document("A < B")
    document.heading("Part")
    document.text("Some **bold** words\n  and `a < b`.")
    document.code("python -m x\nls")
    document.table("Numbers", ["Name", "Value"], [["a|b".replace("|", "/"), "1.5"], ["c", "–"]])
    document.figure(image, "What is seen")
    markdown, page = document.markdown(tmp_path), document.html()
    assert markdown.startswith("# A < B\n\n## Part\n\nSome **bold** words and `a < b`.\n")
    assert "\n    python -m x\n    ls\n" in markdown
    assert "| Name | Value |\n| --- | ---: |\n| a/b | 1.5 |\n| c | – |\n" in markdown
    assert "![What is seen](figures/a.png)" in markdown
    assert "<h1>A &lt; B</h1>" in page
    assert "<strong>bold</strong> words and <code>a &lt; b</code>" in page
    assert '<td>a/b</td><td class="number">1.5</td>' in page
    assert 'src="data:image/png;base64,cG5n"' in page
    assert "http" not in page
