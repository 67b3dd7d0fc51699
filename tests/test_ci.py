"""`.ci/run` with tools that fail: each step that fails, fails the run."""

import os
import shutil
import subprocess

import pytest

from tests.repository import ROOT

PYTHON = """
mkdir -p "$3/bin"
touch "$3/bin/activate"
ln -s "$(command -v pip)" "$3/bin/pip"
"""
"""Of `python3 -m venv FOLDER`: an environment whose tools are those of the path."""
PASSED = 'echo "SKIPPED [2] tests/test_a.py:3: no ROS here"; echo "2100 passed, 2 skipped in 9.1s"'
TOOLS = {
    "python3": PYTHON,
    "pip": "",
    "ruff": "",
    "pyright": "",
    "pytest": PASSED,
    "matrix": 'echo "  137 passed in 5.0s, after 3 s of installing"',
    # What it may do without.
    "apt-get": "exit 1",
    "roscore": "exit 1",
    "chromium": "exit 1",
}
FAULTS = {
    "no environment": {"python3": "exit 1"},
    "pip": {"pip": "exit 1"},
    "a formatter": {"ruff": '[ "$1" = check ]'},
    "a linter": {"ruff": '[ "$1" = format ]'},
    "types": {"pyright": "echo an error; exit 1"},
    "matrix": {"matrix": "echo 1 failed, 136 passed in 5.0s; exit 1"},
    "a test": {"pytest": f"{PASSED}; exit 1"},
    "nothing collected": {"pytest": 'echo "no tests ran in 0.01s"; exit 5'},
    "nothing collected, nobody told": {"pytest": 'echo "no tests ran in 0.01s"'},
    "few tests": {"pytest": 'echo "===== 12 passed in 0.40s ====="'},
    "no word of pytest's": {"pytest": ""},
    "all skipped": {"pytest": 'echo "2100 skipped in 2.00s"'},
}


def run(folder, *words, **faults):
    """Run a copy of `.ci/run` among stubs, some of them replaced by other shell code."""
    checkout, tools = folder / "checkout", folder / "tools"
    for place in (checkout / ".ci", tools):
        place.mkdir(parents=True)
    for name in ("run", "install"):
        shutil.copy(ROOT / ".ci" / name, checkout / ".ci" / name)
    for name, code in (TOOLS | faults).items():
        path = checkout / ".ci/matrix" if name == "matrix" else tools / name
        path.write_text(f"#!/bin/sh\n{code}\n")
        path.chmod(0o755)
    path = f"{tools}{os.pathsep}/usr/bin{os.pathsep}/bin"
    return subprocess.run(
        ["bash", ".ci/run", *words],
        cwd=checkout,
        env={"PATH": path, "HOME": str(folder), "CI": "true"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )


def test_all_steps_pass_without_what_is_optional(tmp_path):
    done = run(tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "  2 no ROS here" in done.stdout.splitlines()
    # After what the smoke tests printed: whoever reads the last line, reads the suite's.
    assert done.stdout.splitlines()[-1] == "2100 passed, 2 skipped in 9.1s"


@pytest.mark.parametrize("fault", FAULTS)
def test_a_step_that_fails_fails_the_run(tmp_path, fault):
    done = run(tmp_path, **FAULTS[fault])
    assert done.returncode != 0, done.stdout


@pytest.mark.parametrize(
    ("words", "extras"), [((), ".[test]"), (("-m", ""), ".[test,docs]")]
)
def test_the_site_is_installed_where_slow_tests_build_it(tmp_path, words, extras):
    done = run(tmp_path, *words, pip='echo "$@" >>"$HOME/pip"')
    assert done.returncode == 0, done.stdout + done.stderr
    lines = (tmp_path / "pip").read_text().splitlines()
    assert [line.split()[-1] for line in lines if "-e" in line.split()] == [extras]


@pytest.mark.parametrize(
    ("uv", "tools"), [("", {"uv"}), ("; exit 1", {"uv", "pip"})], ids=["uv", "pip"]
)
def test_uv_installs_or_else_pip(tmp_path, uv, tools):
    said = f"""echo pip "$@" >>"$HOME/said"
if [ "$3" = uv ]; then
  echo '#!/bin/sh' >"$(dirname "$0")/uv"
  echo 'echo uv "$@" >>"$HOME/said"{uv}' >>"$(dirname "$0")/uv"
  chmod +x "$(dirname "$0")/uv"
fi"""
    done = run(tmp_path, pip=said)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = (tmp_path / "said").read_text().splitlines()
    assert {line.split()[0] for line in lines if ".[test]" in line} == tools


def test_fewer_tests_than_the_floor_are_counted_aloud(tmp_path):
    done = run(tmp_path, pytest='echo "12 passed in 0.40s"')
    assert "12 tests passed, and 2000 are the least" in done.stdout
    assert "failed: count" in done.stdout
