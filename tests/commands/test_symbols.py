import dataclasses
import itertools
import json
import warnings

import numpy as np
import polars as pl
import pytest

from neurosym_jax.commands.symbols import run
from neurosym_jax.data.tables import GUARDS, ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models.disk import load_model, save_model
from neurosym_jax.symbolic.forecast import format_forecast
from neurosym_jax.symbolic.qtc import observe
from tests.repository import ROOT

MODEL = ROOT / "checkpoints" / "neurosym_simulations_8"


@pytest.fixture
def recording(tmp_path):
    """1 walks east past 2, which stands to the north; from the sixth step on 3 walks beside 1."""
    rows = []
    for step in range(20):
        people = {1: (0.4 * step, 0.0), 2: (1.1, 3.0), 3: (0.4 * step, -1.0)}
        rows += [(step, i, *xy) for i, xy in people.items() if i < 3 or step >= 4]
    path = tmp_path / "walk.txt"
    np.savetxt(path, rows, fmt="%d %d %.4f %.4f")
    return path


def test_states_over_time_as_text(recording, tmp_path, capsys):
    run(recording, window=0, out=tmp_path / "out")
    text = capsys.readouterr().out
    assert "walk, window 0: 2 people, weighting cnd" in text
    (line,) = (line for line in text.splitlines() if line.startswith("(1, 2)"))
    # Towards the other for three steps, then away, always to the right of the line; 2
    # stands.
    assert line.split()[2:] == ["-0+0", ".", ".", "+0+0", *["."] * 11]
    # Always two zeros.
    assert "cnd is constant here; try --weighting quantised" in text
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"pairs.png"}


def test_constant_weights_are_not_told_to_be_what_they_are(tmp_path, capsys):
    path = tmp_path / "walk.txt"
    rows = [(step, i, 0.4 * step, i) for step in range(20) for i in (1, 2)]
    np.savetxt(path, rows, fmt="%d %d %.4f %.4f")
    run(path, weighting="quantised", out=tmp_path / "out")
    assert "weighting quantised is constant here\n" in capsys.readouterr().out


@pytest.mark.slow
def test_weights_of_a_model(recording, tmp_path, capsys):
    run(recording, model=MODEL, out=tmp_path / "out")
    out = capsys.readouterr().out
    assert "window 4: 3 people, weighting cnd" in out
    assert "constant" not in out
    with pytest.raises(InputError, match="SGAN weighs no pairs"):
        run(recording, model=MODEL.with_name("sgan_simulations_8"))


def test_a_window_has_the_steps_of_the_model(recording, tmp_path, capsys):
    model = load_model(MODEL)
    config = dataclasses.replace(model.config, period=0.2)
    save_model(tmp_path / "m", dataclasses.replace(model, config=config))
    run(recording, model=tmp_path / "m", window=0, out=tmp_path / "out")
    (line,) = (
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("(1, 2)")
    )
    # Twice as fine as above: between 1.0 and 1.2 m the distance stays.
    assert line.split()[2:] == ["-0+0", *["."] * 4, "00+0", "+0+0", *["."] * 8]


def test_a_forecast_is_told_written_and_drawn(recording, tmp_path, capsys):
    out = tmp_path / "out"
    run(recording, window=0, model=MODEL, forecast=True, samples=4, out=out)
    text = capsys.readouterr().out
    assert "walk, window 0: 2 people, 4 samples of NeuroSyM" in text
    rows = [
        json.loads(line) for line in (out / "forecast.jsonl").read_text().splitlines()
    ]
    assert {(row["k"], row["l"]) for row in rows} == {(1, 2), (2, 1)}
    for row in rows:
        assert set(row["events"]) >= {"approaches", "meets", "follows"}
        assert len(row["states"]) == 8
        assert all(0 < step["probability"] <= 1 for step in row["states"])


def test_names_of_people_are_said_and_steer_no_terminal(tmp_path, capsys):
    rows = ["frame,id,x,y"]
    for step in range(20):
        rows.append(f"{step},$a$\x9b,{0.4 * step:.1f},0")
        rows.append(f"{step},ben,{8 - 0.4 * step:.1f},0.5")
    path = tmp_path / "walk.csv"
    path.write_text("\n".join(rows), encoding="utf-8")
    run(path, out=tmp_path / "out", read=ReadOptions(fps=2.5, allow=("slow",)))
    assert "\n($a$\\x9b, ben)" in capsys.readouterr().out
    likely = {"probability": 0.9, "seconds": None}
    row = {"k": "a\x9b", "l": "ben", "events": {"approaches": likely}}
    assert "a\\x9b" in format_forecast([row])


def test_a_table_has_the_states_that_a_window_shows(recording, tmp_path, capsys):
    out = tmp_path / "states.csv"
    run(recording, out=out)
    assert capsys.readouterr().out == (f"49 states of 3 pairs, weighting cnd: {out}\n")
    table = pl.read_csv(out)
    # 1 and 2 are there for 19 steps; 3 for 15, of which the first begins in step 4.
    counts = table.group_by("k", "l").len().sort("k", "l").rows()
    assert counts == [(1, 2, 19), (1, 3, 15), (2, 3, 15)]
    assert table.filter(k=1, l=3)["seconds"].to_list()[0] == pytest.approx(5 * 0.4)
    pair = table.filter(k=1, l=2).select("q1", "q2", "q3", "q4")
    assert pair.rows()[:4] == [(-1, 0, 1, 0)] * 3 + [(1, 0, 1, 0)]
    assert set(table["recording"]) == {"walk"}
    run(recording, out=out, weighting="quantised,speed=2")
    slow = pl.read_csv(out).select("q1", "q2")
    assert set(slow.rows()) == {(0, 0)}


def test_a_table_has_all_pairs_of_names_in_order(tmp_path):
    """As QTC of each pair alone; people who are not seen for a step have no state then."""
    rng = np.random.default_rng(0)
    walk = rng.normal(0, 0.3, (12, 4, 2)).cumsum(axis=0) + 1e6
    rows = []
    for step, who in itertools.product(range(12), range(4)):
        if (step, who) != (6, 2):
            x, y = walk[step, who].round(4).tolist()
            rows.append({"time": 0.4 * step, "id": f"=p{who}", "x": x, "y": y})
    pl.DataFrame(rows).write_csv(tmp_path / "a.csv")
    out = tmp_path / "states.csv"
    read = ReadOptions(max_gap=0.5, allow=tuple(GUARDS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        run(tmp_path / "a.csv", out=out, read=read)
    table = pl.read_csv(out)
    assert len(table) == 11 * 3 + 9 * 3
    for first, second in itertools.combinations(range(4), 2):
        pair = table.filter(k=f"'=p{first}", l=f"'=p{second}")
        paths = walk[:, [first, second]].round(4).swapaxes(0, 1) - 1e6
        states = np.asarray(observe(*paths))
        if 2 in (first, second):
            states = np.delete(states, (5, 6), axis=0)
        assert pair.select("q1", "q2", "q3", "q4").rows() == [
            *map(tuple, states.tolist())
        ]


@pytest.mark.parametrize(
    "given", [{"window": 0}, {"forecast": True}, {"style": "talk"}]
)
def test_a_table_is_of_no_window(recording, tmp_path, given):
    with pytest.raises(InputError, match=r"with --out .*states\.csv"):
        run(recording, out=tmp_path / "states.csv", **given)
