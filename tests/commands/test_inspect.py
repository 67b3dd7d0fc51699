"""The first command of a newcomer: words, a picture, and the next two commands."""

import re
import shlex
from unittest import mock

import numpy as np
import pytest
import tyro

import neurosym_jax as nj
from neurosym_jax.commands import inspect, models
from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.data.recordings import open_source
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models.disk import RECOMMENDED, find_model
from neurosym_jax.plotting import tracks as drawing
from tests.data.test_schema import CROWD, PIXELS, TABLES, lines, read_as_told

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
OTHERS = {
    # name: content, and the options that a user gives
    "text": (lines("{step}0 {id} {x} {y}"), {}),
    "pixels": (lines("{t},{id},{u},{v}", head="t,id,u_px,v_px\n", **PIXELS), {"unit": "0.02"}),
    "slow": (lines("{t},{id},{x},{y}", head="t,id,x,y\n", x=CROWD.x / 2, y=CROWD.y / 2),
             {"allow": ("slow",), "flip_y": True}),
}  # fmt: skip


@pytest.mark.parametrize("name", [*TABLES, *OTHERS])
def test_the_next_command_reads_the_file_as_it_was_read(tmp_path, capsys, name):
    content, options = OTHERS.get(name, (TABLES.get(name), {}))
    path = tmp_path / "my tracks.csv"
    path.write_text(content, encoding="utf-8")
    tracks, pasted = read_as_told(path, **options)
    stated = options | {"columns": tuple(shlex.split(pasted))} if pasted else options
    assert inspect.run(path, figure=None, read=ReadOptions(**stated)) == 0
    evaluate, symbols = capsys.readouterr().out.split("next:\n")[1].splitlines()
    words = shlex.split(evaluate)
    start = ["neurosym", "evaluate", "--data", str(path), "--model", RECOMMENDED]
    assert words[:6] == start
    assert shlex.split(symbols)[-len(words[6:]) or 99 :] == words[6:]
    (again,) = read_any(path, tyro.cli(ReadOptions, args=words[6:]))
    for array in ("stamp", "id", "position"):
        np.testing.assert_array_equal(getattr(again, array), getattr(tracks, array))
    if "text" in (name, tracks.reading.format):
        assert words[6:] == ["--fps", "25"]
    elif tracks.reading.format == "columns":
        assert "--columns" in words


@pytest.mark.slow
def test_the_picture_has_the_forecast_of_the_busiest_moment(
    tmp_path, monkeypatch, capsys
):
    path, figure = tmp_path / "walk.csv", tmp_path / "new/all.png"
    path.write_text(TABLES["German"], encoding="utf-8")
    (tracks,) = read_any(path)
    draw_scene = mock.Mock(wraps=drawing.draw_scene)
    monkeypatch.setattr(drawing, "draw_scene", draw_scene)
    assert inspect.run(path, figure) == 0
    past, future, samples = draw_scene.call_args.args[1:]
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert samples[RECOMMENDED].shape == (20, *future.shape)
    # Nobody has counted more people who are seen for 16 steps from one moment on.
    steps = {
        person: set(np.rint(tracks.stamp[tracks.id == person] / 0.4))
        for person in set(tracks.id)
    }
    counts = []
    for at in range(200):
        window = set(range(at, at + 16))
        counts.append(sum(window <= seen for seen in steps.values()))
    assert len(past) == max(counts) > 3
    start = tracks.stamp[(tracks.position == past[0, 0]).all(axis=1)]
    assert counts[round(start[0] / 0.4)] == max(counts)
    error = (
        np.linalg.norm(samples[RECOMMENDED] - future, axis=-1).mean(axis=(1, 2)).min()
    )
    assert error < 0.5 * np.linalg.norm(past[:, -1:] - future, axis=-1).mean()


def test_what_is_taken_for_a_tracking_error_is_said(tmp_path):
    steps = np.arange(16.0)
    rows = [(0.4 * t, 1, 0.5 * t, 9 * (t == 5)) for t in steps] + [
        (0.4 * t, 2, 0.5 * t, 3) for t in steps
    ]
    path = tmp_path / "walk.csv"
    path.write_text(
        "time,id,x,y\n" + "\n".join(",".join(map(str, row)) for row in rows)
    )
    with pytest.warns(InputWarning, match="tracking error"):
        inspect.run(path, tmp_path / "f.png", read=ReadOptions(allow=("fast",)))


def test_what_cannot_be_forecast_is_said(tmp_path, capsys):
    (tmp_path / "walk.csv").write_text("when,x,y,id\n1,1000,0,1\n0,0,0,1\n2,2000,0,1\n")
    figure = tmp_path / "f/all.png"
    read = ReadOptions(columns=("time=when",), unit="mm")
    assert inspect.run(tmp_path / "walk.csv", figure, read=read) == 0
    out = capsys.readouterr().out
    assert "walk.csv: table with named columns" in out
    assert "people 1, points 3, duration 2.0 s, 1 points a second, 0 gaps" in out
    assert "warning: row 3: time runs backward for agent 1" in out
    assert "no forecast: nobody is seen for 6 s, 16 steps" in out
    command = shlex.split(out.splitlines()[-1])
    assert command[:3] == ["neurosym", "replay", str(tmp_path / "walk.csv")]
    words = " ".join(command[3:])
    assert words == "--model recommended --dashboard --columns time=when --unit mm"
    assert figure.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="it is a folder"):
        inspect.run(tmp_path / "walk.csv", tmp_path, read=read)


def test_the_figure_of_another_recording_stays(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    figures = tmp_path / "results/figures"
    for folder in ("a", "b", "a"):
        path = tmp_path / folder / "walk.csv"
        path.parent.mkdir(exist_ok=True)
        path.write_text("time,x,y,id\n0,0,0,1\n1,1,0,1\n2,2,0,1\n")
        assert inspect.run(path) == 0
    out = capsys.readouterr().out
    names = ["tracks_walk.png", "tracks_walk_2.png"]
    assert re.findall(r"wrote results/figures/(.*)", out) == [*names, names[0]]
    assert sorted(file.name for file in figures.iterdir()) == names
    # Nor is a figure overwritten that says nothing of a recording.
    (figures / names[0]).write_bytes(b"mine")
    assert inspect.run(path) == 0
    assert (figures / names[0]).read_bytes() == b"mine"


def test_a_folder(tmp_path, capsys):
    (tmp_path / "bad.txt").write_text("0 1 2\n")
    assert inspect.run(tmp_path, None) == 2
    (tmp_path / "good.txt").write_text("0 1 2 3\n1 1 2 3\n")
    alone = [f"{10 * step} 1 {step / 2} 0" for step in range(16)]
    (tmp_path / "alone.txt").write_text("\n".join(alone))
    assert inspect.run(tmp_path, None) == 0
    out = capsys.readouterr().out
    assert "bad.txt: row 1: 3 columns" in out
    assert "altogether 2 recordings of 3 files" in out
    assert out.endswith(f"--data {tmp_path} --model recommended --min-agents 1\n")
    with pytest.raises(InputError, match=r"min_agents=1 tests people alone, too$"):
        nj.evaluate(nj.load_model("recommended"), tmp_path / "alone.txt")


def test_the_next_commands_of_nested_folders_find_the_recordings(tmp_path, capsys):
    walk = "".join(f"{10 * step} 1 {step / 2} 0\n" for step in range(16))
    more = walk + "".join(f"{10 * step} 2 {step / 2} 3\n" for step in range(16))
    for folder, rows in {"one": walk, "two": more}.items():
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "walk.txt").write_text(rows)
    assert inspect.run(tmp_path, None) == 0
    evaluate, symbols = capsys.readouterr().out.split("next:\n")[1].splitlines()
    data = shlex.split(evaluate)[3]
    assert data == shlex.split(symbols)[2] == str(tmp_path / "two")
    assert open_source(data).scenes == ("walk",)


def test_no_forecast_is_offered_of_a_single_moment(tmp_path, capsys):
    (tmp_path / "walk.csv").write_text("time,id,x,y\n0.5,1,0,0\n0.5,2,3,0\n")
    assert inspect.run(tmp_path / "walk.csv", None) == 0
    assert "replay" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("row", "speeds"),
    [("0.4,1,2.66,0.88", "median 0.88, fastest 0.88 m/s"), ("", "unknown")],
)
def test_what_few_rows_do_not_say_is_left_out(row, speeds, tmp_path, capsys):
    (tmp_path / "a.csv").write_text(
        f"time,person,x,y\n0.0,1,2.31,0.85\n0.0,2,5.02,1.17\n{row}\n"
    )
    assert inspect.run(tmp_path / "a.csv", None) == 0
    assert f" m, speeds {speeds}\n    scenes 8+8: 0" in capsys.readouterr().out


def test_models_begin_with_the_one_to_take(capsys):
    models.run()
    first, _, *families, _, last = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{RECOMMENDED}: take this one")
    counts = {}
    for line in families:
        name, count, *_ = line.split()
        counts[name] = int(count)
    assert len(first.splitlines() + families) < 10
    assert "models --all" in last
    models.run(all=True)
    rows = capsys.readouterr().out.splitlines()[3:]
    names = [row.split()[0] for row in rows]
    assert sum(counts.values()) == len(names)
    assert (
        counts["anchors"]
        == sum(re.match("anchors_", name) is not None for name in names)
        == 12
    )
    assert find_model(RECOMMENDED).name in names


def test_networks_of_another_family_are_counted(monkeypatch, capsys):
    monkeypatch.setattr(models, "models_at_hand", lambda: [("transformer_eth_8", None)])
    models.run()
    assert "others          1 models" in capsys.readouterr().out
