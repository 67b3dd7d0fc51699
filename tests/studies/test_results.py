"""Pages that a study prints from JSON files of evaluations, against the study as it is."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("study", "files", "page"),
    [
        ("results", ["results.json", "results_joint_metrics.json"], "results.md"),
        ("cross_domain", ["cross_domain/*.json"], "cross_domain.md"),
    ],
)
def test_a_page_is_what_its_study_prints(study, files, page):
    paths = [str(path) for name in files for path in sorted(ROOT.glob(f"docs/{name}"))]
    command = [sys.executable, "-m", f"studies.{study}", *paths]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert printed == (ROOT / "docs" / page).read_text(encoding="utf-8")
