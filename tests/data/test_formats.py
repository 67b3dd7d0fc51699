"""Rates, folders, and files that are damaged or large."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from neurosym_jax.commands.inspect import describe
from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.data.formats import data_files
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
    points = "".join(SAMPLES["trajnet"].replace('"f": 0', f'"f": {10 * n}') for n in range(2))
    texts = dict.fromkeys(("biwi_eth_train", "zara01"), SAMPLES["text"])
    texts["obsmat"], texts["trajnet"] = SAMPLES["obsmat"], '{"scene": {"fps": 5}}\n' + points
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
    assert [path.name for path in data_files(tmp_path)] == ["a.CSV", "b.tsv", "c.ndjson"]
    (tmp_path / "goals.csv").write_text("goal,x,y\n1,2,3\n")
    with pytest.warns(InputWarning, match=r"goals\.csv: left out: it has no columns of tracks"):
        assert len(data_files(tmp_path)) == 3
    assert len(data_files(tmp_path, ReadOptions(columns=("id=goal",)))) == 4
    for name in ("b.tsv", "a.CSV", "c.ndjson"):
        (tmp_path / name).unlink()
    with pytest.warns(InputWarning), pytest.raises(InputError, match="its tables have no columns"):
        data_files(tmp_path)


bits = st.one_of(
    st.binary(max_size=30),
    st.sampled_from([b"1e308", b"-1e300", b"9" * 400, b"9" * 5000, b"nan", b"inf", b"\x00"]),
    st.sampled_from([b"\n", b"\t", b",", b";", b" ", b'"', b"{", b"[", b"]", b"#", b"\r", b"_"]),
    st.sampled_from([b"\xff\xfe", b"\xef\xbb\xbf", "ö".encode("latin-1"), b"\xe2\x80\xa8"]),
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


def test_a_header_of_100_000_bodies_is_fast(tmp_path):
    names = "\t".join(f"Helmet_{n} {axis}" for n in range(100_000) for axis in "XYZ")
    row = "\t".join(["5"] * 300_000)
    (tmp_path / "a.tsv").write_text(f"Frame\tTime\t{names}\n1\t0.0\t{row}\n2\t0.1\t{row}\n")
    start = time.process_time()
    with pytest.warns(InputWarning, match="everybody there twice"):
        (tracks,) = read_any(tmp_path / "a.tsv", ReadOptions(yes_really=True))
    assert len(tracks.id) == 200_000
    assert time.process_time() - start < 5
