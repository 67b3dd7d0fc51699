import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data import ReadOptions, read_any, single_scene, windows_from

NAMED = ReadOptions(columns=("time=t0", "id=who", "x=px", "y=py"))


def test_named_columns(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("who;px;note;py;t0\nAnn;1000;a;2000;0.5\nBob;-3;b;4;0.5\nAnn;1500;c;2000;1\n")
    (tracks,) = read_any(path, NAMED)
    assert_array_equal(tracks.id, [0, 0, 1])
    assert_array_equal(tracks.stamp, [0.5, 1, 0.5])
    assert_array_equal(tracks.position, [[1000, 2000], [1500, 2000], [-3, 4]])
    path.write_text('"t","id","x","y"\n0,"7, junior","1.5",2\n0.4,"7, junior",1.75, "2"\n')
    assert_array_equal(read_any(path)[0].position, [[1.5, 2], [1.75, 2]])


@pytest.mark.parametrize("separator", [",", "\t", "; ", " "])
def test_usual_names_and_frames(tmp_path, separator):
    rows = [["Frame", "ped_id", "X", "y"], ["10", "4", "1", "2"], ["20", "4", "1.5", "2"]]
    (tmp_path / "a.csv").write_text("\n".join(separator.join(row) for row in rows))
    (tracks,) = read_any(tmp_path / "a.csv")
    assert_allclose(tracks.stamp, [0.4, 0.8])
    assert_array_equal(tracks.id, [4, 4])
    assert_allclose(read_any(tmp_path / "a.csv", ReadOptions(fps=12.5))[0].stamp, [0.8, 1.6])


def test_dates_texts_and_extras(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(
        "time,person,x,y,g,kind,run\n"
        "2024-05-01T12:00:00.0Z,b,100.0,1,7,adult,A\n"
        "2024-05-01T12:00:00.4Z,b,150.5,2,7,adult,A\n"
        "2024-05-01T12:00:00.0Z,a,-3.0,3,,child,A\n"
    )
    options = ReadOptions(columns=("group=g", "kind=kind"), unit="cm")
    (tracks,) = read_any(path, options)
    assert tracks.recording == "walk"
    assert_array_equal(tracks.id, [0, 1, 1])
    assert_allclose(tracks.stamp - 1714564800, [0, 0, 0.4], atol=1e-6)
    assert_allclose(tracks.position, [[-0.03, 0.03], [1, 0.01], [1.505, 0.02]])
    assert_array_equal(tracks.extras["group"], [np.nan, 7, 7])
    assert_array_equal(tracks.extras["kind"], [1, 0, 0])
    windows = windows_from(path, 1, 1, min_agents=1, read=ReadOptions(columns=("group=5",)))
    assert single_scene(windows, 0).extras["group"].tolist() == [7, 0, 0, 0]
    path.write_text(path.read_text().replace("child,A", "child,B"))
    assert [tracks.recording for tracks in read_any(path, options)] == ["walk_A", "walk_B"]
