"""Files of an evaluation: rows are kept as they come, a report is replaced when whole."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import report
from neurosym_jax.evaluation.report import check_report, evaluate_into, read_report, write_report
from neurosym_jax.evaluation.results import Settings, each_result
from neurosym_jax.evaluation.test_sets import TestSet as Case
from neurosym_jax.evaluation.test_sets import baseline, make_test
from neurosym_jax.runtime.executor import executor

ROOT = Path(__file__).parents[2]
SETTINGS = Settings(samples=2)
OLD = {"format": 2, "rows": [{"model": "of before"}]}


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


def timeless(rows):
    """Rows without durations."""
    clock = ("seconds", "latency", "forecasts_per_second")
    return [{n: v for n, v in row.items() if not n.startswith(clock)} for row in rows]


@pytest.fixture(scope="module")
def whole(tests, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "rows.json"
    rows, results = evaluate_into(path, tests, SETTINGS, facts={"protocol": "sgan"})
    assert rows == [result.row for result in results]
    assert json.loads(path.read_text()) == {
        "format": 2,
        "protocol": "sgan",
        "recordings": [tests[0].windows.reading[0].to_json()],
        "rows": rows,
    }
    assert read_report(path).to_dicts() == rows
    return timeless(rows)


@pytest.mark.parametrize("after", range(5))
def test_interrupted_after_any_row(tests, whole, tmp_path, monkeypatch, after):
    path = tmp_path / "rows.json"
    path.write_text(json.dumps(OLD))

    def interrupted(*arguments):
        for number, result in enumerate(each_result(*arguments)):
            if number == after:
                raise KeyboardInterrupt
            yield result

    with monkeypatch.context() as patch:
        patch.setattr(report, "each_result", interrupted)
        if after < 4:
            with pytest.raises(KeyboardInterrupt):
                evaluate_into(path, tests, SETTINGS)
            assert json.loads(path.read_text()) == OLD  # The finished report stays.
        else:
            evaluate_into(path, tests, SETTINGS)
    log = path.with_suffix(".jsonl")
    kept = log.read_text()
    assert kept.count("\n") == after
    log.write_text(kept + '{"checkpoint": null, "mod')  # A process was killed as it wrote.
    shown = []
    rows, results = evaluate_into(path, tests, SETTINGS, resume=True, show=shown.append)
    assert timeless(rows) == timeless(json.loads(path.read_text())["rows"]) == whole
    assert [len(of) for of in shown] == [2, 2]
    assert log.read_text().startswith(kept)
    # Results are of the test sets that were evaluated whole, for a figure compares all of one.
    assert [result.row for result in results] == rows[{0: 0, 1: 2, 2: 2}.get(after, 4) :]


def test_rows_of_another_evaluation_are_evaluated_again(tests, whole, tmp_path):
    path = tmp_path / "rows.json"
    evaluate_into(path, tests, SETTINGS)
    moved = make_test(tests[0].test_set, tests[0].entries, [walk(1.001)])
    other = make_test(tests[0].test_set, tests[0].entries[1:], [walk(1)])
    for given, settings, fresh in (
        (tests, SETTINGS, 0),
        ([moved], SETTINGS, 2),
        (tests[:1], Settings(samples=3), 2),
        (tests[:1], SETTINGS, 2),  # The log has the rows of the last evaluation only.
        ([other], SETTINGS, 0),
    ):
        rows, results = evaluate_into(path, given, settings, resume=True)
        assert len(results) == fresh
        assert len(rows) == sum(len(test.entries) for test in given)


def test_in_other_processes_the_rows_are_the_same(tests, whole, tmp_path, monkeypatch):
    monkeypatch.setattr("neurosym_jax.plugins._loaded", {})  # Not the plugins of other tests.
    with executor(jobs=1) as pool:
        rows, _ = evaluate_into(tmp_path / "rows.json", tests, SETTINGS, pool=pool)
    for row, other in zip(timeless(rows), whole, strict=True):
        for name, value in row.items():
            assert value == (
                pytest.approx(other[name]) if isinstance(value, float) else other[name]
            )


def test_a_report_is_replaced_and_it_is_said(tmp_path, capsys):
    path = tmp_path / "new/rows.json"
    assert not check_report(path)
    write_report(path, [], {})
    assert capsys.readouterr() == ("", "")
    write_report(path, [{"model": "a"}], {"protocol": "sgan"})
    assert capsys.readouterr().err == f"replacing the report in {path}\n"
    assert json.loads(path.read_text()) == {
        "format": 2,
        "protocol": "sgan",
        "rows": [{"model": "a"}],
    }


@pytest.mark.parametrize("content", [b"thesis", b"[]", b'{"format": 1}', b"\xff\x00", b""])
@pytest.mark.parametrize("name", ["mine.json", "mine.jsonl"])
def test_nothing_else_is_overwritten(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    if name == "mine.jsonl" and not content:
        assert not check_report(tmp_path / "mine.json")
        return
    with pytest.raises(InputError, match=rf"{name}: is not a report of ours"):
        write_report(tmp_path / "mine.json", [], {})
    assert path.read_bytes() == content


def test_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for path, reason in (
        (tmp_path, "cannot be written"),
        (tmp_path / "file/rows.json", "cannot be written"),
        (tmp_path / "rows.jsonl", "name it .json"),
    ):
        with pytest.raises(InputError, match=reason):
            write_report(path, [], {})


STOP = """
import os, signal, threading
import numpy as np
from neurosym_jax.evaluation import register_metric

once = threading.Lock()

@register_metric("stop", "stop", on_host=True)
def stop(forecast, scene):
    log = os.environ.get("STOP_AFTER", "")
    if os.path.exists(log) and os.path.getsize(log) and once.acquire(blocking=False):
        os.kill(os.getpid(), signal.SIGINT)
    return np.zeros(scene.valid.shape)
"""
"""Ctrl-C once, when a row is written."""


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_resume_goes_on(tmp_path):
    path, plugin = tmp_path / "rows.json", tmp_path / "stop.py"
    plugin.write_text(STOP)
    command = [sys.executable, ROOT / "evaluate.py", "--no-figures", "--json", path]
    command += ["--samples", 2, "--dataset", "cross-path", "--resume", "--plugin", plugin]
    command += ["--baselines", "constant_velocity", "constant_velocity_sampled"]
    command = list(map(str, command))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "timeout": 300}
    env = {**os.environ, "STOP_AFTER": str(path.with_suffix(".jsonl"))}
    stopped = subprocess.run(command, env=env, check=False, **pipes)
    assert (stopped.returncode, stopped.stdout) == (130, "")
    lines = stopped.stderr.splitlines()
    assert [line for line in lines if not line.startswith("[")] == ["interrupted"]
    (first,) = path.with_suffix(".jsonl").read_text().splitlines()
    done = subprocess.run(command, check=True, **pipes)
    assert {**json.loads(path.read_text())["rows"][0], "inputs": json.loads(first)["inputs"]} == (
        json.loads(first)
    )
    assert "constant velocity, sampled" in done.stdout
