"""Tables with named columns, text files of ETH/UCY, and the forms of THÖR."""

import itertools
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data import ReadOptions, read_any, single_scene, windows_from
from neurosym_jax.data.readers.thor import Qtm
from neurosym_jax.data.recordings import SCENES, split_files
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError

# (frame, ped, x, y) with ids, coordinates and order as untidy as they come.
ROWS = [
    (0, 7, 1.5, -2.0),
    (0, 3, 0.25, 4.0),
    (1, 3, 0.5, 4.125),
    (1, 7, 1.75, -2.0),
    (2, 3, 1, 4),
]
UNTIDY = (
    [3, 3, 3, 7, 7],
    [0, 0.4, 0.8, 0, 0.4],
    [[0.25, 4], [0.5, 4.125], [1, 4], [1.5, -2], [1.75, -2]],
)
"""What they say: ids, seconds and metres."""


def lines(template, scale=1, end="\n"):
    return (
        end.join(template.format(scale * frame, *rest) for frame, *rest in ROWS) + end
    )


def qtm(*rows, separator="\t"):
    preamble = [
        ["NO_OF_FRAMES", "3"],
        ["FREQUENCY", "50"],
        ["DESCRIPTION", "--"],
    ] * 3 + [["X"]]
    return "".join(separator.join(map(str, row)) + "\n" for row in [*preamble, *rows])


def body(name):
    rest = [
        "Y",
        "Z",
        "Roll",
        "Pitch",
        "Yaw",
        "Residual",
        *[f"Rot[{i}]" for i in range(9)],
        "",
    ]
    return [f"{name} X", *rest]


NAMED = ReadOptions(columns=("time=t0", "id=who", "x=px", "y=py"))
USUAL = "Frame,ped_id,X,y\n10,4,1,2\n20,4,1.5,2"
HEADER = ["Frame", "Time", *body("Helmet_2"), *body("Citi_1"), *body("Helmet_10")]
ZERO, PAD = [0.0] * 16 + [""], [9.0] * 13 + [""]
BODIES = [
    [1, 0.0, 1000, 2000, 1700, *PAD, 5, 5, 5, *PAD, 4000, -500, 1700, *PAD],
    [2, 0.02, *ZERO, 6, 5, 5, *PAD, 4100, -500, 1700, *PAD],
    [3, 0.04, 1200, 0, 0, *PAD, 7, 5, 5, *PAD, *[""] * 17],
]
SEEN = ([2, 2, 10, 10], [0, 0.04, 0, 0.02], [[1, 2], [1.2, 0], [4, -0.5], [4.1, -0.5]])
PARTS = ("Helmet_7 - 1 ", "Helmet_7 Centroid_", "DARKO_Robot Centroid_")
MARKERS = [
    "Frame",
    "Time",
    *[part + axis for part, axis in itertools.product(PARTS, "XYZ")],
]
FILES = {
    # text, options, and what is read
    "named": (
        "who;px;note;py;t0\nAnn;1000;a;2000;0.5\nBob;-3;b;4;0.5\nAnn;1500;c;2000;1\n",
        NAMED,
        ([0, 0, 1], [0.5, 1, 0.5], [[1000, 2000], [1500, 2000], [-3, 4]]),
    ),
    "quoted": (
        '"t","id","x","y"\n0,"7, junior","1.5",2\n0.4,"7, junior",1.75, "2"\n',
        AS_IT_SAYS,
        ([0, 0], [0, 0.4], [[1.5, 2], [1.75, 2]]),
    ),
    **{
        f"usual names, {mark!r}": (
            USUAL.replace(",", mark),
            AS_IT_SAYS,
            ([4, 4], [0.4, 0.8], [[1, 2], [1.5, 2]]),
        )
        for mark in (",", "\t", "; ", " ")
    },
    "usual names and a rate": (
        USUAL,
        ReadOptions(fps=12.5),
        ([4, 4], [0.8, 1.6], [[1, 2], [1.5, 2]]),
    ),
    "ids that are no float64": (
        "t,id,x,y\n0,9007199254740993,1,2\n0,9007199254740992,3,4\n",
        AS_IT_SAYS,
        ([0, 1], [0, 0], [[3, 4], [1, 2]]),
    ),
    "blanks": (lines("{} {} {} {}", 6), AS_IT_SAYS, UNTIDY),
    "tabs": (lines("{}\t{}\t{}\t{}\t", end="\r\n"), AS_IT_SAYS, UNTIDY),
    "commas": (
        "\ufeff# frame ped x y\n\n" + lines("{}, {}, {}, {}"),
        AS_IT_SAYS,
        UNTIDY,
    ),
    "semicolons": (lines("{};{};{};{}") + "\n\n   \n# the end", AS_IT_SAYS, UNTIDY),
    "more blanks": (lines("  {}   {}  {} {}  ", 10), AS_IT_SAYS, UNTIDY),
    "fractions": (lines("{}.0\t{}.0\t{}\t{}", 10), AS_IT_SAYS, UNTIDY),
    "exponents": (lines("{:.8e} {:.8e} {:.8e} {:.8e}", 10), AS_IT_SAYS, UNTIDY),
    "rounded as SGAN does": (
        "0 1 1.23456789 499999.99996\n",
        AS_IT_SAYS,
        ([1], [0], [[1.2346, 500000.0]]),
    ),
    "from another frame on": (
        "".join(f"{780 + 10 * n} 1 {n} 0\n" for n in (0, 1, 2, 5)),
        AS_IT_SAYS,
        ([1] * 4, [31.2, 31.6, 32, 33.2], [[0, 0], [1, 0], [2, 0], [5, 0]]),
    ),
    "6D": (qtm(HEADER, *BODIES), AS_IT_SAYS, SEEN),
    "6D, without a tab after the header": (qtm(HEADER[:-1], *BODIES), AS_IT_SAYS, SEEN),
    "centroids beside markers": (
        qtm(
            MARKERS,
            [1, 0.01, 9, 9, 9, 100, 200, 300, 1, 2, 3],
            [2, 0.02, 9, 9, 9, "", "", "", 1, 2, 3],
            separator=",",
        ),
        AS_IT_SAYS,
        ([7], [0.01], [[0.1, 0.2]]),
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_files_are_read(tmp_path, name):
    text, options, truth = FILES[name]
    (tmp_path / "Exp_1_run_1_6D.tsv").write_bytes(text.encode())
    (tracks,) = read_any(tmp_path / "Exp_1_run_1_6D.tsv", options)
    assert tracks.recording == "Exp_1_run_1_6D"
    assert_array_equal(tracks.id, truth[0])
    assert_allclose(tracks.stamp, truth[1], atol=1e-12)
    assert_array_equal(tracks.position, truth[2])


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
    windows = windows_from(
        path, 1, 1, min_agents=1, read=ReadOptions(columns=("group=5",))
    )
    assert single_scene(windows, 0).extras["group"].tolist() == [7, 0, 0, 0]
    path.write_text(path.read_text().replace("child,A", "child,B"))
    assert [tracks.recording for tracks in read_any(path, options)] == [
        "walk_A",
        "walk_B",
    ]


def test_splits_leave_one_out(tmp_path):
    names = list(itertools.chain(*SCENES.values()))
    for part, ending in {"all": "", "train": "_train", "val": "_val"}.items():
        (tmp_path / part).mkdir()
        for name in [*names, *(["crowds_zara03", "uni_examples"] if ending else [])]:
            (tmp_path / part / f"{name}{ending}.txt").touch()
    for scene, own in SCENES.items():
        assert [path.stem for path in split_files(tmp_path, scene, "test")] == list(own)
        for split in ("train", "val"):
            names = {path.stem for path in split_files(tmp_path, scene, split)}
            assert len(names) == 8 - len(own)
            assert not names & {f"{name}_{split}" for name in own}
        assert len(split_files(tmp_path, None, "train")) == 8
    (tmp_path / "all/biwi_eth.txt").unlink()
    for folder, scene, split, message in (
        (tmp_path, "zara9", "test", "unknown data set 'zara9'"),
        (tmp_path, "eth", "test", r"biwi_eth\.txt: missing, and data set eth needs it"),
        (tmp_path / "absent", None, "val", r"absent/val/\*\.txt: missing"),
    ):
        with pytest.raises(InputError, match=message):
            split_files(folder, scene, split)


def test_a_whole_run_is_read_in_time(tmp_path):
    header = [
        "Frame",
        "Time",
        *itertools.chain(*(body(f"Helmet_{k}") for k in range(1, 14))),
    ]
    person = "\t".join(["1234.567"] * 16) + "\t"
    row = "\t".join([person] * 13)
    rows = [(frame, frame / 100, row) for frame in range(25_000)]
    path = tmp_path / "long_6D.tsv"
    path.write_text(qtm(header, *rows))
    seconds = []
    # The least of three: what runs beside a test takes its time, too.
    for _ in range(3):
        start = time.process_time()
        (tracks,) = Qtm().read(path, ReadOptions(), 0.4)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 2
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
