"""Rates, folders, and files that are damaged, large or refused.

What cannot be read ends in one line that names the file, the row and the reason;
refusals of whole tables are in `studies.mistakes`, which `tests/studies` runs.
"""

import itertools
import os
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from neurosym_jax.commands.inspect import describe
from neurosym_jax.data import ReadOptions, open_source, read_any, windows_from
from neurosym_jax.data.recordings import data_files
from neurosym_jax.data.tables import GUARDS
from neurosym_jax.data.tracks import on_grid
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError, InputWarning

SAMPLES = {
    "text": "780 1 8.4 3.6\n790 1 9.1 3.7\n",
    "obsmat": "  7.8e+02 1.0e+00 8.4 0.0 3.6 1.7 0 0.2\n 7.86e+02 1.0e+00 9.1 0 3.7 1.7 0 0.2\n",
    "cliff": "0.02,12001,-0.046,-3.443,1.0,1.571\n0.42,12001,-0.046,-3.043,1.0,1.571\n",
    "qtm": "NO_OF_FRAMES\t2\nFREQUENCY\t100\nFrame\tTime\tHelmet_1 X\tHelmet_1 Y\tHelmet_1 Z\n"
    "1\t0.0\t1000\t2000\t3\n2\t0.01\t1000\t2000\t3\n",
    "tracklets": "Time,frame_id,x,y,z,ag_id,tracklet_id\n0.01,1,1,2,3,Helmet_3,0.0\n",
    "trajnet": '{"track": {"f": 0, "p": 1, "x": 1, "y": 2}}\n',
    "columns": "t,id,x,y\n0,1,2,3\n",
}


def test_rates_of_frames(tmp_path):
    """obsmat knows its own; of SGAN's files only eth's frames are not 0.4 s apart."""
    points = "".join(
        SAMPLES["trajnet"].replace('"f": 0', f'"f": {10 * n}') for n in range(2)
    )
    texts = dict.fromkeys(("biwi_eth_train", "zara01"), SAMPLES["text"])
    texts["obsmat"], texts["trajnet"] = (
        SAMPLES["obsmat"],
        '{"scene": {"fps": 5}}\n' + points,
    )
    for name, text in texts.items():
        (tmp_path / f"{name}.txt").write_text(text)
    for options, seconds in (
        (ReadOptions(), [0.4, 0.4, 0.4, 0.2]),
        (ReadOptions(eth_stride=6), [2 / 3, 0.4, 0.4, 0.2]),
        (ReadOptions(fps=15), [2 / 3, 2 / 3, 0.4, 2 / 3]),
    ):
        read = [read_any(tmp_path / f"{name}.txt", options)[0] for name in texts]
        assert_allclose([np.ptp(tracks.stamp) for tracks in read], seconds)


def test_folders(tmp_path):
    for name in ("b.tsv", "a.CSV", "LICENSE", "c.ndjson"):
        (tmp_path / name).touch()
    assert [path.name for path in data_files(tmp_path)] == [
        "a.CSV",
        "b.tsv",
        "c.ndjson",
    ]
    (tmp_path / "goals.csv").write_text("goal,x,y\n1,2,3\n")
    (tmp_path / "d.txt").write_text("# id frame x y z\n1 0 1 2 0\n1 10 2 2 0\n")
    with pytest.warns(
        InputWarning, match=r"goals\.csv: left out: it has no columns of tracks"
    ):
        assert len(data_files(tmp_path)) == 4
    assert len(data_files(tmp_path, ReadOptions(columns=("id=goal",)))) == 5
    for name in ("b.tsv", "a.CSV", "c.ndjson", "d.txt"):
        (tmp_path / name).unlink()
    with (
        pytest.warns(InputWarning),
        pytest.raises(InputError, match="its tables have no columns"),
    ):
        data_files(tmp_path)


def test_a_folder_leaves_out_what_is_no_table_and_no_table_of_long_rows(tmp_path):
    """The head of a file may end within a quoted field; a note has quotes of its own."""
    note = "n" * 2000
    rows = [f'{at},"ann",{at},0,"{note}"' for at in range(40)]
    path = tmp_path / "long.csv"
    path.write_text("\n".join(["time,id,x,y,note", *rows]))
    (tmp_path / "notes.txt").write_text('"open, and\nno more\n')
    with pytest.warns(InputWarning, match=r"notes\.txt: left out"):
        assert data_files(tmp_path) == [path]


def test_a_header_is_read_though_its_numbers_fit_a_layout_without(tmp_path):
    rows = [f"{0.4 * at},1,{at},0.5,1.25,0.1" for at in range(20)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows))
    (without,) = read_any(path)
    path.write_text("\n".join(["time,id,x,y,speed,heading", *rows]))
    (tracks,) = read_any(path)
    assert (without.reading.format, tracks.reading.format) == ("cliff", "columns")
    assert tracks.position.tolist() == without.position.tolist()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("text", ["time,id,x,y\n", "name\n", "", '"\n', ",,\n"])
def test_a_table_without_rows_is_refused_and_nothing_else_is_said(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_any(tmp_path / "a.csv")
    assert "damaged" not in str(caught.value)


bits = st.one_of(
    st.binary(max_size=30),
    st.sampled_from(
        [b"1e308", b"-1e300", b"9" * 400, b"9" * 5000, b"nan", b"inf", b"\x00"]
    ),
    st.sampled_from(
        [b"\n", b"\t", b",", b";", b" ", b'"', b"{", b"[", b"]", b"#", b"\r", b"_"]
    ),
    st.sampled_from(
        [b"\xff\xfe", b"\xef\xbb\xbf", "ö".encode("latin-1"), b"\xe2\x80\xa8"]
    ),
)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", SAMPLES)
@given(
    cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), bits), max_size=4),
    other=st.sampled_from(list(SAMPLES)),
)
def test_fuzz_damaged(kind, cuts, other, tmp_path_factory):
    """Readers give tracks or one line, and all that comes after reading takes the tracks."""
    content = SAMPLES[kind].encode() * 2
    for place, length, put in cuts:
        at = int(place * len(content))
        content = content[:at] + put + content[at + length :]
    path = tmp_path_factory.mktemp("f") / "a.csv"
    path.write_bytes(content)
    for reader in (None, kind, other):
        message = ""
        try:
            for tracks in read_any(path, ReadOptions(format=reader)):
                describe(tracks)
                cut_windows([on_grid(tracks)], 1, 1, min_agents=1)
        except InputError as error:
            message = str(error)
        assert "\n" not in message
        assert len(message) < len(str(path)) + 400


@pytest.mark.slow
def test_a_header_of_100_000_bodies_is_fast(tmp_path):
    names = "\t".join(
        f"Helmet_{n} {axis}" for n, axis in itertools.product(range(100_000), "XYZ")
    )
    row = "\t".join(["5"] * 300_000)
    (tmp_path / "a.tsv").write_text(
        f"Frame\tTime\t{names}\n1\t0.0\t{row}\n2\t0.1\t{row}\n"
    )
    start = time.process_time()
    with pytest.warns(InputWarning, match="everybody there twice"):
        (tracks,) = read_any(tmp_path / "a.tsv", ReadOptions(allow=tuple(GUARDS)))
    assert len(tracks.id) == 200_000
    assert time.process_time() - start < 5


# Rows begin with 12.
HELMET = "X\n" * 10 + "Frame\tTime\tHelmet_1 X\tHelmet_1 Y\tHelmet_1 Z\n"
TRACKLETS = "Time,x,y,ag_id,tracklet_id\n"
POINT = '{"track": {"f": 1, "p": 1, "x": 1, "y": 0}}\n'
TABLE = "t,id,x,y\n"

REFUSALS = [
    ("text", f"{2**54} 1 2 3\n", "is not a whole number"),
    ("text", "", "the file has no rows"),
    ("columns", "Dear all,\n", "has no rows below its header: .Dear all,.$"),
    ("text", "0 1 2 3\n1 1 2\n", r"row 2: 3 columns, not 4: '1 1 2'"),
    (
        "text",
        "0 1 2\n1 1 2\n",
        r"row 1: 3 columns, not 4: '0 1 2' \(format, or columns=\('time=1'",
    ),
    ("text", "0,1,,3\n", "no row has a position"),
    ("text", "# a comment\n\n0 1 2 3\n1 1 2 x4\n", "row 4: y is not a number: 'x4'"),
    ("text", "0 1 2 3\n1 2 2 3\n0 1 5 5\n", "row 3: repeats agent 1 at 0 s"),
    ("text", "0 1 2 3\n0.5 1 2 3\n", "row 2: frame 0.5 is not a whole number"),
    ("text", "0 1 2 3\n1 1 2 1e300\n", r"row 2: position .* is not a usable number"),
    ("text", "0 1 2 3\n1 1_0 2 3\n", "row 2: id is not a number: '1_0'"),
    ("cliff", "1e12,1,0,0,0,0\n", r"row 1: time .* is not a usable number of seconds"),
    (
        "columns",
        "t,id,x,y" + ",c" * 10**6 + "\n1\n",
        "row 1: has more than 1000000 columns",
    ),
    ("columns", "id,x,y\n1,2,3\n", "which column is time or frame"),
    ("columns", f"{TABLE}1,-1,3,1\n1,n/a,3,1\n", "no row has an id: let a tracker"),
    (
        "columns",
        f"{TABLE}2024-05-01,1,0,0\n2024-13-01,1,0,0\n",
        "row 3: '2024-13-01' is not a d",
    ),
    (
        "columns",
        f'{TABLE}"2024-05-01 1:02:03,4",1,0,0\n',
        r"a date and time, as 2024-05-01 12:30",
    ),
    (
        "columns",
        "t|id|x|y\n0|1|2|3\n",
        r"only the columns 't\|id\|x\|y': separate columns by",
    ),
    ("text", "0\x00\xa0", "no text, and of no other format"),
    ("columns", f'{TABLE}0,"7\n",1,2\n', "wrong quotes .*goes on in the next line"),
    ("trajnet", '{"track": {"f": 1, "p": 1, "x": 0}}', "row 1: y is not a number"),
    (
        "trajnet",
        "\n" + POINT.replace('"f": 1', '"f": 1.5'),
        "row 2: f 1.5 is not a whole number",
    ),
    ("trajnet", POINT.replace('"x": 1', '"x": NaN'), "row 1: x is not a number: 'nan'"),
    ("qtm", "Frame\tTime\tCiti_1 X\tCiti_1 Y\n1\t1\t1\t1", "no `Helmet_1 X`"),
    ("qtm", HELMET, "the file has no rows"),
    ("qtm", f"{HELMET}1\t0\t1\t7\t0\n2\t1\t1\t7\t0\t0\n", "row 13: 6 columns, not 5"),
    ("qtm", f"{HELMET}1\t\t3\t4\t4\n", "row 12: Time is not a number: ''"),
    ("qtm", f"{HELMET}\n1\t0\t0\t0\t0\n", "none of its 1 helmets is ever visible"),
    (
        "qtm",
        f"{HELMET[:-1]}\tHelmet_1 X\n1\t0\t1\t0\t0\t0\n",
        "the header names Helmet_1 X twice",
    ),
    (
        "tracklets",
        "Time,x,y,ag_id\n1,2,3,Helmet_1\n",
        "the header has not one tracklet_id",
    ),
    ("tracklets", f"{TRACKLETS}1,2,3,4,5\n1,9,3,4,5\n", "row 3: repeats"),
]


def test_one_row_that_ends_in_a_separator(tmp_path):
    (tmp_path / "a.csv").write_text(f"{TABLE}1.5,2,3,4,\n")
    (tracks,) = read_any(tmp_path / "a.csv", ReadOptions())
    assert tracks.position.tolist() == [[3, 4]]


@pytest.mark.parametrize(("kind", "text", "message"), REFUSALS)
def test_refusals(tmp_path, kind, text, message):
    path = tmp_path / "bad.txt"
    path.write_text(text, "latin-1")
    with pytest.raises(InputError, match=message) as caught:
        read_any(path, ReadOptions(format=kind))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"columns": ("x=px",)},
            "no column 'px': which column is x. There are 't', 'id', 'x'",
        ),
        ({"columns": ("time",)}, "columns are given as time="),
        ({"fps": float("nan")}, "fps must be"),
        ({"max_gap": -1.0}, "max_gap must be at least 0"),
        ({"unit": "furlong"}, "unit is one of m, "),
        ({"unit": "a=cm,b=1e9"}, "not '1e9'"),
        ({"format": "qtm", "unit": "cm"}, "unit is of no use for QTM export"),
        ({"format": "text", "time_unit": "ms"}, "time_unit is of no use for rows of"),
    ],
)
def test_options(tmp_path, options, message):
    (tmp_path / "a.csv").write_text(f"{TABLE}1,2,3,4\n")
    with pytest.raises(InputError, match=message):
        read_any(tmp_path / "a.csv", ReadOptions(**options))


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    start, no_file = time.monotonic(), "is a folder, pipe or device, not a file"
    for place, message in (
        (tmp_path / "pipe.csv", no_file),
        (tmp_path / "folder.csv", no_file),
        (Path("/dev/zero"), no_file),
        (tmp_path / "absent", "cannot be read"),
        (tmp_path / ("a" * 5000), "cannot be read"),
    ):
        with pytest.raises(InputError, match=message):
            read_any(place)
    for read in (
        open_source(tmp_path / "pipe.csv").recordings,
        lambda _: windows_from(tmp_path, 2, 2),
    ):
        with pytest.raises(InputError, match=no_file):
            read("pipe")
    assert time.monotonic() - start < 5
