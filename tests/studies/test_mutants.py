"""Mistakes that the study plants: each another program, none in messages or annotations."""

import ast

from studies.mutants import _mistakes, _replaced, mutations

TEXT = """
def f(a: int = 1, b=-2.5, *, c=True) -> int:
    if not a or b <= 3:
        raise ValueError(f"{a + 1}")
    return g(a, b) - é(c)
"""


def test_every_kind_of_mistake_is_planted_in_its_place():
    found = {(ast.unparse(node), ast.unparse(other)) for node, other in mutations(ast.parse(TEXT))}
    assert found == {
        *(("1", "2"), ("2.5", "5.1"), ("-2.5", "2.5"), ("True", "False"), ("3", "4")),
        *(("not a", "a"), ("b <= 3", "b < 3"), ("not a or b <= 3", "not a and b <= 3")),
        *(("g(a, b)", "g(b, a)"), ("g(a, b) - é(c)", "g(a, b) + é(c)")),
    }
    for node, other in mutations(ast.parse(TEXT)):
        text = _replaced(TEXT, node, f"({ast.unparse(other)})")
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(TEXT))
        assert "é(c)" in text


def test_the_package_has_thousands_of_places():
    packages = [package for package, *_ in _mistakes()]
    assert all(packages.count(name) > 200 for name in {*packages})
    assert len(packages) > 2000
