"""Writes qsrlib.json: what QSRlib's own unit tests of QTC give to it, and what they expect.

    python tests/golden/make_qsrlib.py CHECKOUT

CHECKOUT is https://github.com/strands-project/strands_qsr_lib, of which nothing is run: its files
of data are read, and the constants of one test. `LICENSE.qsrlib` is its licence, for these are its
data. The larger recordings of its tests, data2 to data4 with 25 MB of states, are left out.
"""

import ast
import csv
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from neurosym_jax.runtime.files import write_text

CALCULI = ("qtcbs", "qtccs", "qtcbcs")
# qsr_qtc_simplified_abstractclass.py has the defaults, the files are named by what differs.
DEFAULTS = {
    "quantisation_factor": 0.0,
    "validate": True,
    "no_collapse": False,
    "distance_threshold": 1.22,
}
VARIANTS = {
    "defaults": {},
    "q_factor_2p0": {"quantisation_factor": 2.0},
    "validate_nocollapse": {"no_collapse": True},
    "validate_nonocollapse": {},
    "novalidate_nocollapse": {"validate": False, "no_collapse": True},
    "novalidate_nonocollapse": {"validate": False},
}


def main(checkout: Path) -> None:
    """Reads the tests of `checkout`, and writes beside this file."""
    tests, here = checkout / "qsr_lib" / "tests", Path(__file__).parent
    recordings = {
        "data1": recording(tests / "data" / "data1.csv", {"o1": "1", "o2": "2"}),
        "qtc": recording(tests / "data" / "qtc.csv", {"human": "1", "robot": "2"}),
    }
    cases = [*cases_of_data1(tests / "data"), *cases_of_qtc(tests)]
    for case in cases:
        case["expected"] = " ".join(case["expected"])
    rows = ",\n".join(f"  {json.dumps(case)}" for case in cases)
    given = json.dumps(recordings)
    write_text(here / "qsrlib.json", f'{{"recordings": {given},\n"cases": [\n{rows}\n]}}\n')
    shutil.copyfile(checkout / "LICENSE", here / "LICENSE.qsrlib")
    print(f"{len(cases)} cases")


def recording(path: Path, people: dict[str, str]) -> dict[str, list[list[float]]]:
    """The positions of everybody, whose columns are x and y with a number."""
    rows = list(csv.DictReader(path.read_text().splitlines()))
    return {
        name: [[float(row[f"x{number}"]), float(row[f"y{number}"])] for row in rows]
        for name, number in people.items()
    }


def cases_of_data1(folder: Path) -> list[dict]:
    """Rows are "time,k,l,{'calculus': 'state'}"; both orders of the two are in one file."""
    cases = []
    for calculus in CALCULI:
        for variant, changes in VARIANTS.items():
            rows = json.loads((folder / f"data1_{calculus}_{variant}.txt").read_text())
            split = [row.split(",", 3) for row in rows]
            split.sort(key=lambda row: float(row[0]))
            for k, l in (("o1", "o2"), ("o2", "o1")):  # noqa: E741
                expected = [
                    ast.literal_eval(row[3])[calculus] for row in split if row[1:3] == [k, l]
                ]
                cases.append(
                    {"recording": "data1", "k": k, "l": l, "calculus": calculus}
                    | {**DEFAULTS, **changes, "expected": expected}
                )
    return cases


def cases_of_qtc(tests: Path) -> list[dict]:
    """Those of qtc_tester.py: what it expects stands in its class, or in files without collapse."""
    tree = ast.parse((tests / "qtc_tester.py").read_text())
    given = entry(tree, "dynamic_args", "qtcs")
    without = {**given, "validate": False, "no_collapse": True}
    cases = []
    for calculus in CALCULI:
        every = json.loads((tests / "data" / f"{calculus}_nocollapse.txt").read_text())
        collapsed = entry(tree, "correct", calculus)
        for parameters, states in ((given, collapsed), (without, every)):
            expected = [state[calculus] for state in states]
            cases.append(
                {"recording": "qtc", "k": "human", "l": "robot", "calculus": calculus}
                | {**parameters, "expected": expected}
            )
    return cases


def entry(tree: ast.Module, name: str, key: str) -> Any:
    """`key` of the dict `name`, whose other entries need not be constants."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            table = node.value
            assert isinstance(table, ast.Dict)
            found = dict(zip([ast.unparse(each) for each in table.keys if each], table.values))
            return ast.literal_eval(found[repr(key)])
    raise KeyError(name)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
