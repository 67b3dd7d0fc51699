import numpy as np
import pytest

from neurosym_jax.__main__ import main
from neurosym_jax.commands import inspect
from neurosym_jax.data.inspection import summarise
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.suspicions import suspicions
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.plotting.tracks import plot_tracks


def walk(pace=1.0, people=2, steps=30, period=0.4):
    """People side by side along x at `pace` m/s."""
    frame, person = np.divmod(np.arange(steps * people), people)
    position = np.stack([0.01 + frame * period * pace, 0.7 * person + 0.5], axis=1)
    return make_tracks("walk", frame * period, person, position)


def test_summary():
    whole = walk()
    keep = ~((whole.id == 1) & (whole.stamp > 3.9) & (whole.stamp < 4.5))
    tracks = make_tracks("a", whole.stamp[keep], whole.id[keep], whole.position[keep])
    found = summarise(tracks)
    assert (found.points, found.people, found.gaps) == (58, 2, 1)
    assert found.duration == pytest.approx(11.6)
    assert found.step == pytest.approx(0.4)
    assert found.longest_gap == pytest.approx(1.2)
    assert found.speeds == pytest.approx((1, 1, 1))
    assert found.extent == pytest.approx((11.6, 0.7))
    assert found.scenes == {(8, 8): (3, 6), (8, 12): (0, 0)}
    assert suspicions(tracks) == ()


def test_one_point():
    tracks = make_tracks("a", [0], [1], [[0.5, 1]])
    found = summarise(tracks)
    assert np.isnan(found.step)
    assert found.scenes[8, 8] == (0, 0)
    assert suspicions(tracks) == ()


@pytest.mark.parametrize(
    ("tracks", "message"),
    [
        (walk(1000), "look like millimetres"),
        (walk(100), "look like pixels"),
        (walk(2.5), "needs --eth-stride 6"),
        (walk(0.001), "hardly anybody moves"),
        (walk(period=2.0), r"2\.00 s apart: longer gaps than 1 s are not filled"),
    ],
)
def test_suspicions(tracks, message):
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(suspicions(tracks))


def test_leaps_twins_and_whole_numbers():
    tracks = walk()
    leap = make_tracks(
        "a", tracks.stamp, tracks.id, tracks.position + 9.0 * (tracks.stamp > 4)[:, None]
    )
    (line,) = suspicions(leap)
    assert line.startswith("2 steps are faster than 10 m/s (the fastest 32.")
    assert "by person 0 at 4.00 s" in line
    same = make_tracks("a", tracks.stamp, tracks.id, tracks.position * [1, 0])
    (line,) = suspicions(same)
    assert line.startswith("30 points are duplicates")
    pixels = make_tracks("a", tracks.stamp, tracks.id, np.rint(tracks.position * 2) * 1.0)
    assert any("whole numbers" in line for line in suspicions(pixels))


def test_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    table = "when,x,y,id\n1,1000,0,1\n0,0,0,1\n2,2000,0,1\n"
    (tmp_path / "walk.csv").write_text(table)
    arguments = ["--columns", "time=when", "--unit", "mm", "--figure", tmp_path / "f/all.png"]
    with pytest.raises(SystemExit) as caught:
        main(["inspect", *map(str, [tmp_path / "walk.csv", *arguments])])
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert "walk.csv: table with named columns" in out
    assert "people 1, points 3, duration 2.0 s, 1 points a second, 0 gaps" in out
    assert "warning: row 2: time runs backward for agent 1" in out
    assert (tmp_path / "f/all.png").read_bytes().startswith(b"\x89PNG")


def test_folder_with_a_file_that_is_none(tmp_path, capsys):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/bad.txt").write_text("0 1 2\n")
    with pytest.raises(InputError, match="row 1: 3 columns"):
        inspect.run(inspect.Options(tmp_path / "sub/bad.txt"))
    assert inspect.run(inspect.Options(tmp_path)) == 2
    (tmp_path / "good.txt").write_text("0 1 2 3\n1 1 2 3\n")
    assert inspect.run(inspect.Options(tmp_path)) == 0
    out = capsys.readouterr().out
    assert "bad.txt: row 1: 3 columns" in out
    with pytest.raises(InputError, match="absent: cannot be read"):
        inspect.run(inspect.Options(tmp_path / "absent"))


def test_real_samples(shared, capsys):
    assert inspect.run(inspect.Options(shared / "data/thor")) == 0
    out = capsys.readouterr().out
    assert "altogether 6 recordings of 4 files" in out
    assert "warning" not in out
    assert inspect.run(inspect.Options(shared / "data/eth_ucy/all/biwi_eth.txt")) == 0
    assert "needs --eth-stride 6" in capsys.readouterr().out
    eth = inspect.Options(shared / "data/eth_ucy/all/biwi_eth.txt", read=ReadOptions(eth_stride=6))
    assert inspect.run(eth) == 0
    assert "warning" not in capsys.readouterr().out


def test_figure_of_many_recordings():
    figure = plot_tracks([walk()] * 30)
    assert len(figure.axes) == 24
