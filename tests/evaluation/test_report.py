import json

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import check_replaceable, format_table, write_json


def row(**fields):
    return {
        "checkpoint": None,
        "model": "constant velocity",
        "scene": "zara1",
        "obs_len": 8,
        "pred_len": 12,
        "samples": 1,
        "scenes": 602,
        "agents": 2253,
        "joint": {"ade": 0.4312, "fde": 0.9613},
        "marginal": {"ade": 0.3311, "fde": 0.7222},
        "collision_rate": 0.0345,
        "metrics": {
            "joint_ade": 0.4312,
            "joint_fde": 0.9613,
            "marginal_ade": 0.3311,
            "marginal_fde": 0.7222,
            "collision_rate": 0.0345,
            "of_a_plugin": None,
        },
        "seconds": {"latency": 0.00123},
        "forecasts_per_second": 12345.6,
        **fields,
    }


def test_a_table_fits_the_terminal():
    rows = [row(), row(model="SGAN", checkpoint="models/zara1.pt", samples=20), row(scene="eth")]
    for width in (60, 80, 120):
        lines = [line.rstrip() for line in format_table(rows, width=width).splitlines()]
        assert max(map(len, lines[:-2])) <= width  # below are sentences
        at = lines.index("zara1: 8 + 12 steps, 602 scenes, 2253 people")
        assert lines[at + 1].split()[:2] == ["joint", "joint"]
        assert lines[at + 2].split()[:3] == ["model", "ADE", "FDE"]
        assert lines[at + 3].startswith("constant velocity  0.431  0.961")
        assert lines[at + 4].startswith("SGAN ")
    assert "joint: the best of k forecasts of the whole scene" in lines[-2]
    assert "of_a_plugin" not in "".join(lines)  # It has no value anywhere.
    assert "latency" in lines[at + 1]


def test_what_an_earlier_version_does_not_know_is_left_out():
    text = format_table([row(metrics={"joint_ade": 0.5})])
    assert "0.500" in text
    assert "±" not in text


def test_a_report_is_replaced_and_it_is_said(tmp_path, capsys):
    path = tmp_path / "new/rows.json"
    assert not check_replaceable(path)
    write_json(path, {"format": 1, "rows": []})
    assert capsys.readouterr().out == ""
    write_json(path, {"format": 1, "rows": [1]})
    assert capsys.readouterr().out == f"replacing the report in {path}\n"
    assert json.loads(path.read_text()) == {"format": 1, "rows": [1]}


@pytest.mark.parametrize("content", [b"thesis", b"[]", b'{"format": 1}', b"\xff\x00", b""])
def test_nothing_else_is_overwritten(tmp_path, content):
    path = tmp_path / "mine"
    path.write_bytes(content)
    with pytest.raises(InputError, match="mine: is not a report of ours"):
        write_json(path, {"format": 1, "rows": []})
    assert path.read_bytes() == content


def test_where_nothing_can_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_json(tmp_path, {"format": 1, "rows": []})
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_json(tmp_path / "file/rows.json", {"format": 1, "rows": []})
