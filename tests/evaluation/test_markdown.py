from neurosym_jax.evaluation.markdown import markdown_table


def test_a_table():
    rows = [["a|b", "1"], ["two\nlines", "2"]]
    assert markdown_table(["name", ""], rows, right=1).splitlines() == [
        "| name | |",
        "|---|---:|",
        r"| a\|b | 1 |",
        "| two lines | 2 |",
    ]
