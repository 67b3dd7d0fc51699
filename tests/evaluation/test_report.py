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


def test_table():
    sgan = row(checkpoint="models/zara1.pt", model="SGAN", samples=20)
    text = format_table([row(), sgan, row(scene="eth")])
    lines = text.splitlines()
    title = lines.index("zara1: 8 steps observed, 12 forecast; 602 scenes, 2253 agents; metres")
    heads, first, second = lines[title + 1 : title + 3], lines[title + 3], lines[title + 4]
    assert heads[0].split()[:4] == ["joint", "joint", "marginal", "marginal"]
    assert heads[1].split()[:4] == ["ADE", "FDE", "ADE", "FDE"]
    assert "of_a_plugin" in heads[1]
    errors = "0.431 0.961 0.331 0.722 3.5 % -"
    assert " ".join(first.split()).startswith(f"constant velocity {errors} 1 ")
    assert " ".join(second.split()).startswith(f"SGAN zara1.pt {errors} 20 ")
    assert "joint: the best of k forecasts of the whole scene" in text
    assert "checkpoints in models" in text
    assert text.count("zara1: ") == text.count("eth: ") == 1
    assert len(heads[1]) == len(first) == len(second)


@pytest.mark.parametrize(
    ("paths", "shown"),
    [
        (["a/x/1.pt", "a/y/1.pt"], ["x/1.pt", "y/1.pt"]),
        (["1.pt", "a/1.pt"], ["1.pt", "a/1.pt"]),
        (["/m/1.pt", "a/1.pt"], ["/m/1.pt", "a/1.pt"]),
        (["m/1.pt", "m/1.pt"], ["1.pt", "1.pt"]),
    ],
)
def test_checkpoints_by_what_tells_them_apart(paths, shown):
    lines = format_table([row(checkpoint=path, model="SGAN") for path in paths]).splitlines()
    found = [line.split()[1] for line in lines if line.startswith("  SGAN")]
    assert found == shown


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
