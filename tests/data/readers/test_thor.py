import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.data.readers.thor import Qtm
from neurosym_jax.data.windows import cut_windows


def qtm(path, header, rows, separator="\t"):
    preamble = [["NO_OF_FRAMES", "3"], ["FREQUENCY", "50"], ["DESCRIPTION", "--"]] * 3 + [["X"]]
    lines = (separator.join(map(str, line)) for line in [*preamble, header, *rows])
    path.write_text("\n".join(lines) + "\n")
    return path


def body(name):
    rest = ["Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *[f"Rot[{i}]" for i in range(9)], ""]
    return [f"{name} X", *rest]


def test_6d(tmp_path):
    header = ["Frame", "Time", *body("Helmet_2"), *body("Citi_1"), *body("Helmet_10")]
    zero, pad = [0.0] * 16 + [""], [9.0] * 13 + [""]
    rows = [
        [1, 0.0, 1000, 2000, 1700, *pad, 5, 5, 5, *pad, 4000, -500, 1700, *pad],
        [2, 0.02, *zero, 6, 5, 5, *pad, 4100, -500, 1700, *pad],
        [3, 0.04, 1200, 0, 0, *pad, 7, 5, 5, *pad, *[""] * 17],
    ]
    for wide in (header, header[:-1]):  # The header may lack the separator at its end.
        (tracks,) = read_any(qtm(tmp_path / "Exp_1_run_1_6D.tsv", wide, rows))
        assert tracks.recording == "Exp_1_run_1_6D"
        assert_array_equal(tracks.id, [2, 2, 10, 10])
        assert_array_equal(tracks.stamp, [0, 0.04, 0, 0.02])
        assert_array_equal(tracks.position, [[1, 2], [1.2, 0], [4, -0.5], [4.1, -0.5]])


def test_magni_centroids_beside_markers(tmp_path):
    header = ["Frame", "Time"]
    for part in ("- 1 ", "Centroid_"):
        header += [f"Helmet_7 {part}{axis}" for axis in "XYZ"]
    header += [f"DARKO_Robot Centroid_{axis}" for axis in "XYZ"]
    rows = [[1, 0.01, 9, 9, 9, 100, 200, 300, 1, 2, 3], [2, 0.02, 9, 9, 9, "", "", "", 1, 2, 3]]
    (tracks,) = read_any(qtm(tmp_path / "magni.csv", header, rows, ","))
    assert_array_equal(tracks.id, [7])
    assert_array_equal(tracks.position, [[0.1, 0.2]])


@pytest.mark.slow
def test_a_whole_run_is_read_in_time(tmp_path):
    header = ["Frame", "Time", *[name for k in range(1, 14) for name in body(f"Helmet_{k}")]]
    row = "\t".join("\t".join(["1234.567"] * 16) + "\t" for _ in range(13))
    rows = [(frame, frame / 100, row) for frame in range(25_000)]
    path = qtm(tmp_path / "long_6D.tsv", header, rows)
    start = time.process_time()
    (tracks,) = Qtm().read(path, ReadOptions(), 0.4)
    assert time.process_time() - start < 2
    assert len(tracks.id) == 13 * 25_000


def test_tracklets_of_several_runs(shared, tmp_path):
    runs = read_any(shared / "data/thor/THOR-MAGNI_Scenario_5.csv")
    assert [np.unique(run.id).tolist() for run in runs] == [
        [3, 8, 9, 10],
        [1, 3, 6, 8, 10],
        [1, 3, 6, 8, 10],
        [3, 8, 9, 10],
    ]
    assert sum(len(run.id) for run in runs) == 10_040
    assert_array_equal(runs[0].position[0], [-3.926, -0.455969])
    assert cut_windows(runs, 8, 8).sizes.max() == 5
    path = tmp_path / "a.csv"  # A helmet at one time twice is in two runs.
    path.write_text("Time,x,y,ag_id,tracklet_id\n1,2,3,Helmet_4,5\n1,7,3,Helmet_4,6\n")
    assert [run.recording for run in read_any(path)] == ["a_1", "a_2"]
