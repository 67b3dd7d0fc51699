"""The tests that hang on rounding, their programs compiled as those of users are.

Where this file is among what is run, they run here and not in the other way beside it;
those that are slow do so for a release, and else in the other way.
"""

import os

import pytest

from tests.conftest import accepted
from tests.repository import ROOT, exhaustive, run_python

FILES = [
    path
    for path in ROOT.glob("tests/**/test_*.py")
    if "mark.rounding" in path.read_text(encoding="utf-8")
]


@pytest.mark.skipif(
    not os.environ.get("XLA_FLAGS"), reason="every test runs in this way"
)
@pytest.mark.parametrize(
    "marks", ["rounding and not slow", exhaustive("rounding and slow")]
)
def test_as_users_have_it(marks):
    words = ("-m", "pytest", "-n0", "-p", "no:cacheprovider", "-m", marks)
    run_python(*words, *FILES, XLA_FLAGS="")


@pytest.mark.slow
def test_flags_that_xla_refuses_are_left_out():
    flags = {"xla_backend_optimization_level": "0", "xla_no_such_flag": "true"}
    assert accepted(flags) == "--xla_backend_optimization_level=0"
