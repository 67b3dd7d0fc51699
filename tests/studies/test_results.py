"""Pages that a study prints from JSON files of evaluations, against the study as it is."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


DOCS = ROOT / "docs"


def study(*words: object) -> str:
    command = [sys.executable, "-m", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_the_results_are_what_their_study_writes(tmp_path):
    study("studies.results", DOCS / "results.json", DOCS / "results_joint_metrics.json", tmp_path)
    for name in ("results.md", "results.csv"):
        assert (tmp_path / name).read_text(encoding="utf-8") == (DOCS / name).read_text("utf-8")


def test_other_domains_are_what_their_study_prints():
    printed = study("studies.cross_domain", *sorted(DOCS.glob("cross_domain/*.json")))
    assert printed == (DOCS / "cross_domain.md").read_text(encoding="utf-8")
