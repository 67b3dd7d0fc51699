"""What may import what (docs/architecture.md): read from the source, so that no path is missed."""

import ast
import functools
import graphlib
import re
from pathlib import Path

import pytest

from tests.repository import ROOT

PACKAGE = ROOT / "neurosym_jax"
LIBRARIES = {
    # library: what may import it, by the beginning of the path in the package
    "distributed": ("runtime/",),
    "flax": ("models/",),
    "matplotlib": ("plotting/",),
    "rclpy": (),
    "rosbags": (),
    "rospy": (),
    "torch": ("interop/",),
    "tyro": ("commands/",),
}
ON_DEMAND = {"distributed", "matplotlib", "safetensors", "torch"}
"""Imported inside functions, but for matplotlib in `plotting`, which is imported so itself."""
PACKAGES = (
    *("data", "simulation", "symbolic", "models", "evaluation", "training", "families"),
    *("interop", "plotting", "commands"),
)
"""No package imports one to its right; the families of `models` are a package of their own."""
FAMILIES = ("models/sgan/", "models/anchors/", "models/baselines.py")
LATER = {
    ("data/recordings.py", "simulation"),
    ("models/disk.py", "interop"),
    ("models/forecaster.py", "training"),
    ("training/run.py", "plotting"),
}
"""Files that use a package to their right all the same."""


def imports(path: Path) -> list[tuple[str, bool]]:
    """Modules that a file imports, and whether at once or when a function is called."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    later = set()
    for part in ast.walk(tree):
        on_demand = isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef)
        if isinstance(part, ast.If):
            on_demand = "TYPE_CHECKING" in ast.unparse(part.test)
        if on_demand:
            later |= {id(node) for node in ast.walk(part)}
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [(alias.name, id(node) not in later) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.append((node.module or "", id(node) not in later))
    return names


@functools.cache
def imports_below(folder: Path) -> list[tuple[str, str, bool]]:
    """(file, what it imports, whether at once) of the files below `folder`."""
    found = []
    for path in folder.rglob("*.py"):
        file = path.relative_to(folder).as_posix()
        found += [(file, *imported) for imported in imports(path)]
    return found


def ours(name: str) -> str:
    """The subpackage of an imported module of the package, or an empty text."""
    parts = name.split(".")
    if parts[0] != "neurosym_jax" or len(parts) == 1:
        return ""
    return package("/".join(parts[1:]))


def package(file: str) -> str:
    """The subpackage of a file or of a module's path in the package."""
    if f"{file}/".startswith(FAMILIES) or file == "models/baselines":
        return "families"
    return file.split("/")[0]


@pytest.mark.parametrize("library", LIBRARIES)
def test_a_library_is_imported_in_its_packages(library):
    users = {
        file
        for file, name, _ in imports_below(PACKAGE)
        if name.split(".")[0] == library
    }
    assert {file for file in users if not file.startswith(LIBRARIES[library])} == set()
    assert users or not LIBRARIES[library], "a rule about nothing"


def test_heavy_and_optional_libraries_are_imported_on_demand():
    at_once = set()
    for file, name, now in imports_below(PACKAGE):
        heavy = name.split(".")[0] in ON_DEMAND or ours(name) == "plotting"
        if now and heavy:
            at_once.add((file, name))
    packages = ("plotting/", "commands/")
    assert {
        (file, name) for file, name in at_once if not file.startswith(packages)
    } == set()


def test_packages_import_what_is_left_of_them():
    later = {name: PACKAGES[place + 1 :] for place, name in enumerate(PACKAGES)}
    later["runtime"] = PACKAGES
    wrong = set()
    for file, name, _ in imports_below(PACKAGE):
        if ours(name) in later.get(package(file), ()):
            wrong.add((file, ours(name)))
    assert wrong == LATER


def test_no_two_files_import_each_other():
    graph = {}
    for path in ROOT.glob("neurosym_*/**/*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        graph[module] = {name for name, _ in imports(path)}
    graphlib.TopologicalSorter(graph).prepare()


def test_the_core_uses_no_command_study_test_or_robot():
    outside = {"studies", "tests", "benchmarks", "examples"}
    users = set()
    for file, name, _ in imports_below(PACKAGE):
        command = ours(name) == "commands" and not file.startswith("commands/")
        if command or name.split(".")[0] in outside:
            users.add(file)
    assert users <= {"__main__.py"}
    paths = [path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".pyi")]
    naming = {
        path for path in paths if "neurosym_robot" in path.read_text(encoding="utf-8")
    }
    assert naming == set()


def test_files_say_what_they_are():
    for path in [*ROOT.glob("neurosym_*/**/*.py"), *ROOT.glob("studies/**/*.py")]:
        text = path.read_text(encoding="utf-8")
        if text.strip():
            assert ast.get_docstring(ast.parse(text)), f"{path}: no docstring"
        assert path.stem not in ("utils", "misc", "helpers", "common")
        assert not re.search(r"@dataclasses\.dataclass(?!\(frozen=True)", text), (
            f"{path}: not frozen"
        )
