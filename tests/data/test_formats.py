import time
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.commands.inspect import describe
from neurosym_jax.data.formats import FORMATS, data_files, read_any, sniff
from neurosym_jax.data.readers.columns import read_columns
from neurosym_jax.data.readers.eth_ucy import read_obsmat, read_text
from neurosym_jax.data.readers.qtm import read_qtm
from neurosym_jax.data.readers.thor import read_cliff, read_tracklets
from neurosym_jax.data.readers.trajnet import read_trajnet
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.tracks import make_tracks, on_grid
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
READERS = (read_text, read_obsmat, read_cliff, read_qtm, read_tracklets, read_trajnet)
READERS += (read_columns, read_any, sniff)


@pytest.mark.parametrize("kind", SAMPLES)
def test_each_is_known_by_its_content(tmp_path, kind):
    assert set(SAMPLES) == set(FORMATS) - {"bag"}, "bags are tested with neurosym_robot"
    path = tmp_path / "recording.dat"
    for mark in ("", "\ufeff"):
        path.write_text(mark + SAMPLES[kind])
        assert sniff(path) == kind
        assert len(read_any(path)) == 1


def test_obsmat_and_the_stride_of_eth(tmp_path):
    (tmp_path / "a.txt").write_text(SAMPLES["obsmat"])
    (tracks,) = read_any(tmp_path / "a.txt")
    assert_allclose(np.diff(tracks.stamp), [0.4])
    assert_array_equal(tracks.position, [[8.4, 3.6], [9.1, 3.7]])
    (tmp_path / "b.txt").write_text(SAMPLES["text"])
    (tracks,) = read_any(tmp_path / "b.txt", ReadOptions(stride=6))
    assert_allclose(np.diff(tracks.stamp), [0.4 * 10 / 6])
    with pytest.raises(InputError, match="the stride must be"):
        read_any(tmp_path / "b.txt", ReadOptions(stride=float("nan")))


def test_the_stride_of_eth_alone(tmp_path):
    """Of SGAN's files only eth's frames are not 0.4 s apart."""
    for name in ("biwi_eth_train", "crowds_zara01"):
        (tmp_path / f"{name}.txt").write_text(SAMPLES["text"])
    steps = [
        np.diff(read_any(path, ReadOptions(eth_stride=6))[0].stamp).round(9).tolist()
        for path in sorted(tmp_path.iterdir())
    ]
    assert steps == [[round(4 / 6, 9)], [0.4]]


@pytest.mark.parametrize("kind", SAMPLES)
def test_units(tmp_path, kind):
    path = tmp_path / "a.txt"
    path.write_text(SAMPLES[kind])
    options = ReadOptions(unit="cm")
    if "unit" in FORMATS[kind].uses:
        position = read_any(path)[0].position
        assert_allclose(read_any(path, options)[0].position, position / 100, rtol=1e-12)
    else:
        with pytest.raises(InputError, match=r"--unit is of no use for .*, which fixes it"):
            read_any(path, options)
    with pytest.raises(
        InputError, match="the unit is one of m, cm, mm, or metres as a number, not 'ft'"
    ):
        read_any(path, ReadOptions(unit="ft"))  # pyright: ignore


def test_an_option_that_is_not_used_is_refused(tmp_path):
    path = tmp_path / "a.txt"
    for kind, content in SAMPLES.items():
        path.write_text(content)
        for option, value in {
            "columns": ("time=1", "id=2", "x=3", "y=4"),
            "time_unit": "ms",
            "fps": 25.0,
            "stride": 2.0,
        }.items():
            if option not in FORMATS[kind].uses:
                with pytest.raises(InputError, match=f"--{option.replace('_', '-')} is of no use"):
                    read_any(path, ReadOptions(format=kind, **{option: value}))


def test_real_samples_become_scenes(shared):
    for path in (shared / "data/thor").glob("*_*.csv"):
        if path.stem != "goals_positions":
            source = open_source(path)
            for tracks in source.recordings(source.scenes[0]):
                assert_allclose(tracks.stamp / 0.4 % 1, tracks.stamp[0] / 0.4 % 1, atol=1e-5)
    with pytest.raises(InputError, match=r"goals_positions\.csv: which column"):
        read_any(shared / "data/thor/goals_positions.csv")


def test_what_is_on_the_grid_stays_as_it_is(shared):
    for path in (shared / "data/eth_ucy/all").glob("*.txt"):
        (tracks,) = read_any(path)
        assert on_grid(tracks).position is tracks.position
    off = make_tracks("a", [0, 0.5, 1], [1, 1, 1], [[0, 0], [1, 0], [2, 0]])
    assert_allclose(on_grid(off).stamp, [0, 0.4, 0.8])


def test_another_rate():
    tracks = make_tracks("a", 0.4 * np.arange(9), [1] * 9, np.stack([np.arange(9)] * 2, 1))
    for period in (0.2, 0.4, 0.8):
        found = on_grid(tracks, period)
        assert_allclose(np.diff(found.stamp), period)
        assert_allclose(found.position[:, 0], found.stamp / 0.4, atol=1e-12)
        assert cut_windows([found], 2, 2, min_agents=1).period == period
    for period in (0, -0.4, np.nan, np.inf):
        with pytest.raises(InputError, match="a: the period must be positive"):
            on_grid(tracks, period)


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


SIZE = 40_000
NONSENSE = {
    one: one.encode() * (SIZE // len(one))
    for one in ("9", "[", '{"a":', "\t", ",", "\n", '"', "\0", "1 ", "1 2 3 4\n", "#", "1e", "-")
} | {
    "a row of 6D without end": SAMPLES["qtm"].encode() + b"1\t" * (SIZE // 2),
    "a header without end": b"Frame\t" + b"Helmet_1 X\t" * (SIZE // 11),
    "one point for ever": SAMPLES["trajnet"].encode() * (SIZE // 44),
    "an open quote": SAMPLES["columns"].encode() + b'"' * SIZE,
}


@pytest.mark.parametrize("content", NONSENSE.values(), ids=NONSENSE)
def test_nonsense_takes_no_time_and_little_memory(content, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    start = time.process_time()
    tracemalloc.start()
    survive(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**20 + 150 * SIZE
    assert time.process_time() - start < 10


def survive(path):
    """Every reader gives tracks or one line, and all that comes after reading takes the tracks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for tracks in read_any(path):
                describe(tracks)
                cut_windows([on_grid(tracks)], 1, 1, min_agents=1)
        except InputError:
            pass
    for reader in READERS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            message = ""
            try:
                reader(path)
            except InputError as error:
                message = str(error)
            assert "\n" not in message
            assert len(message) < len(str(path)) + 400


bits = st.one_of(
    st.binary(max_size=30),
    st.sampled_from([b"1e308", b"-1e300", b"9" * 400, b"9" * 5000, b"nan", b"inf", b"\x00"]),
    st.sampled_from([b"\n", b"\t", b",", b";", b" ", b'"', b"{", b"[", b"]", b"#", b"\r", b"_"]),
    st.sampled_from([b"\xff\xfe", b"\xef\xbb\xbf", "ö".encode("latin-1"), b"\xe2\x80\xa8"]),
)


@pytest.mark.parametrize("kind", SAMPLES)
@given(cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), bits), max_size=4))
def test_fuzz_damaged(kind, cuts, tmp_path_factory):
    content = SAMPLES[kind].encode() * 2
    for place, length, put in cuts:
        at = int(place * len(content))
        content = content[:at] + put + content[at + length :]
    path = tmp_path_factory.mktemp("f") / "a.csv"
    path.write_bytes(content)
    survive(path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", SAMPLES)
def test_truncated_anywhere_or_in_another_encoding(kind, tmp_path):
    path = tmp_path / "a.csv"
    for size in range(len(SAMPLES[kind])):
        path.write_bytes(SAMPLES[kind].encode()[:size])
        survive(path)
    path.write_text(SAMPLES[kind], encoding="utf-16")
    survive(path)
