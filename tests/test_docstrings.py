"""Public docstrings give shapes in brackets and what is raised; modules say what is public."""

import ast
import re

from tests.repository import ROOT

PACKAGE = ROOT / "neurosym_jax"
MODULES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.name != "__init__.py"]
ARRAYS = re.compile(r"\b(ndarray|Array|ArrayLike)\b")
SHAPE = re.compile(r"\[[^\]]*\]")


def public_functions(tree):
    """Functions and methods without an underscore, of what is not private itself."""
    for node in tree.body:
        if isinstance(
            node, ast.FunctionDef | ast.ClassDef
        ) and not node.name.startswith("_"):
            if isinstance(node, ast.FunctionDef):
                yield node
            else:
                yield from public_functions(node)


def raises_input_error(function):
    return any(
        isinstance(node, ast.Raise)
        and node.exc
        and "InputError" in ast.unparse(node.exc)
        for node in ast.walk(function)
    )


def takes_arrays(function):
    """A random key has no shape to speak of."""
    arguments = (*function.args.args, *function.args.kwonlyargs)
    return any(
        ARRAYS.search(ast.unparse(argument.annotation))
        for argument in arguments
        if argument.annotation and argument.arg != "key" and "label" not in argument.arg
    )


def test_shapes_and_errors_are_said():
    lacking = []
    for path in MODULES:
        for function in public_functions(ast.parse(path.read_text(encoding="utf-8"))):
            text, name = (
                ast.get_docstring(function) or "",
                f"{path.stem}.{function.name}",
            )
            if (
                takes_arrays(function)
                and not SHAPE.search(text)
                and not text.startswith("See `")
            ):
                lacking.append(f"{name}: takes arrays, but no shape is given")
            if raises_input_error(function) and "Raises:" not in text:
                lacking.append(f"{name}: raises InputError, but does not say so")
    assert lacking == []


def test_every_module_says_what_is_public():
    without = [
        path.relative_to(PACKAGE).as_posix()
        for path in MODULES
        if not re.search("^__all__ = ", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert without == []


def test_sections_of_docstrings_stand_on_lines_of_their_own():
    """`neurosym COMMAND --help` reads the meaning of options from `Args:`."""
    for path in [*MODULES, *ROOT.glob("neurosym_robot/**/*.py")]:
        text = path.read_text(encoding="utf-8")
        joined = re.findall(r"(?m)^ *(?:Args|Returns|Raises): \S.*$", text)
        assert joined == [], path
