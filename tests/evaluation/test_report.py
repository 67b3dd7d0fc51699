"""Files of an evaluation: a report is replaced when whole, and nothing else is."""

import json

import polars as pl
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import check_report, read_report, write_report


def test_a_report_is_replaced_and_it_is_said(tmp_path, capsys):
    path = tmp_path / "new/rows.json"
    assert not check_report(path)
    write_report(path, [], {})
    assert capsys.readouterr() == ("", "")
    write_report(path, [{"model": "a"}, {"model": "b", "crps": 1.0}], {"protocol": "sgan"})
    assert capsys.readouterr().err == f"replacing the report in {path}\n"
    assert json.loads(path.read_text()) == {
        "format": 2,
        "protocol": "sgan",
        "rows": [{"model": "a"}, {"model": "b", "crps": 1.0}],
    }
    wanted = pl.DataFrame({"model": ["a", "b"], "crps": [None, 1.0]})
    assert read_report(path).equals(wanted)


@pytest.mark.parametrize("content", [b"thesis", b"[]", b'{"format": 1}', b"\xff\x00", b""])
def test_nothing_else_is_overwritten(tmp_path, content):
    log = tmp_path / "rows.jsonl"
    log.write_bytes(content)
    if content:
        with pytest.raises(InputError, match=r"rows.jsonl: is not a report of ours"):
            check_report(tmp_path / "rows.json")
    path = tmp_path / "mine.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"mine.json: is not a report of ours"):
        write_report(path, [], {})
    with pytest.raises(InputError, match=r"mine.json: is not a report of ours of format 2"):
        read_report(path)
    assert path.read_bytes() == content
    for place in (tmp_path, path / "rows.json"):
        with pytest.raises(InputError, match="cannot be written"):
            write_report(place, [], {})
