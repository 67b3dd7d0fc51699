"""An evaluation's rows are kept as they come: interrupted anywhere, it goes on to the same file."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.load import make_test
from neurosym_jax.evaluation.plan import TestSet as Case
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.evaluation.rows import evaluate_into
from neurosym_jax.evaluation.run import Settings, each_result

ROOT = Path(__file__).parents[2]
SETTINGS = Settings(samples=2)


def walk(step: float):
    stamp, person = np.divmod(np.arange(40), 2)
    xy = np.stack([step * stamp, 1.0 * person], 1)
    return make_tracks("walk", stamp * 0.4, person, xy)


@pytest.fixture(scope="module")
def tests():
    """Two test sets of two baselines each."""
    names = ("constant_velocity", "constant_velocity_sampled")
    return [
        make_test(Case("walk", 4, ahead), [(None, baseline(n, 4, ahead)) for n in names], [walk(1)])
        for ahead in (2, 3)
    ]


def read(path):
    """The report without what a clock says."""
    report = json.loads(path.read_text())
    for row in report["rows"]:
        assert set(row.pop("seconds")) == {"loading", "compiling", "evaluating", "latency"}
        row.pop("forecasts_per_second")
    return report


@pytest.fixture(scope="module")
def whole(tests, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "rows.json"
    rows, results = evaluate_into(path, tests, SETTINGS)
    assert rows == [result.row for result in results] == json.loads(path.read_text())["rows"]
    return read(path)


@pytest.mark.parametrize("after", range(5))
def test_interrupted_after_any_row(tests, whole, tmp_path, after):
    path = tmp_path / "rows.json"

    def interrupted(*arguments):
        for number, result in enumerate(each_result(*arguments)):
            if number == after:
                raise KeyboardInterrupt
            yield result

    if after < 4:
        with pytest.raises(KeyboardInterrupt):
            evaluate_into(path, tests, SETTINGS, each=interrupted)
    else:
        evaluate_into(path, tests, SETTINGS, each=interrupted)
    if after:
        assert read(path) == whole | {"complete": after == 4, "rows": whole["rows"][:after]}
    rows, results = evaluate_into(path, tests, SETTINGS, resume=True)
    assert read(path) == whole
    assert len(rows) == 4
    # Results are of the test sets that were evaluated whole, for a figure compares all of one.
    assert [result.row for result in results] == rows[{0: 0, 1: 2, 2: 2}.get(after, 4) :]


def test_rows_of_another_evaluation_are_not_gone_on_with(tests, tmp_path, capsys):
    path = tmp_path / "rows.json"
    evaluate_into(path, tests[:1], SETTINGS)
    moved = make_test(tests[0].test_set, tests[0].entries, [walk(1.001)])
    for others, settings in (
        (tests, SETTINGS),
        ([moved], SETTINGS),
        (tests[:1], Settings(samples=3)),
        (tests[:1], Settings(samples=2, metrics=("joint_ade",))),
    ):
        with pytest.raises(InputError, match="begun with other models, data or options"):
            evaluate_into(path, others, settings, resume=True)
    assert "replacing" not in capsys.readouterr().out
    evaluate_into(path, [moved], SETTINGS)
    assert f"replacing the report in {path}" in capsys.readouterr().out


STOP = """
import os, signal, threading
import numpy as np
from neurosym_jax.evaluation import Metric, register_metric

once = threading.Lock()

def stop(forecast, future, valid):
    written = os.path.exists(os.environ.get("STOP_AFTER", ""))
    if written and once.acquire(blocking=False):
        os.kill(os.getpid(), signal.SIGINT)
    return np.zeros(len(valid)), valid.sum(axis=1)

register_metric(Metric("stop", "stop", "m", stop, on_host=True))
"""
"""Ctrl-C once, when a row is written; who presses it again does not wait for an orderly end."""


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_resume_goes_on(tmp_path):
    path, plugin = tmp_path / "rows.json", tmp_path / "stop.py"
    plugin.write_text(STOP)
    command = [sys.executable, ROOT / "evaluate.py", "--no-figures", "--json", path]
    command += ["--samples", 2, "--scene", "cross-path", "--resume", "--plugin", plugin]
    command += ["--baselines", "constant_velocity", "constant_velocity_sampled"]
    command = list(map(str, command))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "timeout": 300}
    env = {**os.environ, "STOP_AFTER": str(path)}
    stopped = subprocess.run(command, env=env, check=False, **pipes)
    assert (stopped.returncode, stopped.stdout) == (130, "")
    lines = stopped.stderr.splitlines()
    assert [line for line in lines if not line.startswith("[")] == ["interrupted"]
    begun = read(path)
    assert not begun["complete"]
    done = subprocess.run(command, check=True, **pipes)
    found = read(path)
    assert found["complete"]
    assert found["rows"][: len(begun["rows"])] == begun["rows"]
    assert "constant velocity, sampled" in done.stdout
