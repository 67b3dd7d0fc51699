import json

import jax

from neurosym_jax.runtime.environment import code_version, run_environment


def test_the_environment_is_json_and_knows_the_threads(monkeypatch):
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    monkeypatch.setenv("NPROC", "3")
    environment = run_environment()
    assert json.loads(json.dumps(environment)) == environment
    assert environment["threads"] == 3
    assert environment["jax"] == jax.__version__


def test_the_commit_of_this_checkout():
    commit = code_version()
    assert commit is None or commit == commit.strip() != ""
