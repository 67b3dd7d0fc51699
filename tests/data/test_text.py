"""What is no text, no file, or larger than it looks ends in one line, soon and in little memory."""

import gzip
import os
import socket
import time
import tracemalloc

import numpy as np
import pytest

from neurosym_jax.data import Head, ReadOptions, make_tracks, read_any, register_format
from neurosym_jax.data.formats import FORMATS, data_files, sniff
from neurosym_jax.data.sources import open_source, windows_from
from neurosym_jax.data.tracks import on_grid
from neurosym_jax.errors import InputError, InputWarning

PLUGIN = """
import dataclasses
import numpy as np
from neurosym_jax.data import Format, make_tracks, register_format

@register_format("pipes")
@dataclasses.dataclass(frozen=True)
class Pipes(Format):
    title = "tracks between pipes"
    uses = frozenset({"unit"})
    shift: float = 0.0

    def knows(self, head):
        return head.text.startswith("#!pipes")

    def read(self, path, options, period):
        rows = [line.split("|") for line in path.read_text().splitlines()[1:]]
        stamp, who, x, y = zip(*((float(t), int(w), float(x), float(y)) for t, w, x, y in rows))
        position = options.metres(path) * np.stack([x, y], axis=1) + self.shift
        return [make_tracks(path.stem, stamp, who, position)]
"""


def test_pipes_sockets_devices_and_folders_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    server = socket.socket(socket.AF_UNIX)
    server.bind(os.path.relpath(tmp_path / "socket.csv"))
    (tmp_path / "folder.csv").mkdir()
    start = time.monotonic()
    for name, what in (("pipe", "pipe"), ("socket", "socket"), ("folder", "folder")):
        with pytest.raises(InputError, match=rf"{name}\.csv: is a {what}, not a file"):
            read_any(tmp_path / f"{name}.csv")
    with pytest.raises(InputError, match="/dev/zero: is a device, not a file"):
        read_any("/dev/zero")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"pipe\.csv: is a pipe"):
        open_source(tmp_path / "pipe.csv").recordings("pipe")
    with pytest.raises(InputError, match=r"is a .*, not a file"):
        windows_from(tmp_path, 2, 2)
    assert time.monotonic() - start < 5
    server.close()


def test_names_that_are_too_long_or_not_utf8(tmp_path):
    long = tmp_path / ("a" * 300)
    for action in (read_any, open_source, data_files):
        with pytest.raises(InputError, match="File name too long"):
            action(long)
    odd = tmp_path / os.fsdecode(b"walk\xff.txt")
    odd.write_text("0 1 2 3\n1 1 2 3\n")
    (tracks,) = read_any(odd)
    assert tracks.recording == r"walk\udcff"
    assert open_source(odd).scenes == (r"walk\udcff",)


def test_a_sparse_file_is_refused_before_memory_is_taken(tmp_path):
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(10**12)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.csv: reading it needs some 12000"):
        read_any(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(10**8)
    with pytest.raises(InputError, match="zero bytes"):
        read_any(tmp_path / "a.csv")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e7


def test_a_header_of_100_000_bodies_is_fast(tmp_path):
    names = "\t".join(f"Helmet_{n} {axis}" for n in range(100_000) for axis in "XYZ")
    row = "\t".join(["5"] * 300_000)
    (tmp_path / "a.tsv").write_text(f"Frame\tTime\t{names}\n1\t0.0\t{row}\n2\t0.1\t{row}\n")
    start = time.process_time()
    with pytest.warns(InputWarning, match="duplicates"):
        (tracks,) = read_any(tmp_path / "a.tsv", ReadOptions(yes_really=True))
    assert len(tracks.id) == 200_000
    assert time.process_time() - start < 5


def test_a_period_of_nothing_is_refused():
    stamp = np.arange(100) * 0.4
    tracks = make_tracks("walk", stamp, np.ones(100, int), np.stack([stamp, stamp], 1))
    with pytest.raises(InputError, match=r"a period of 0\.0002 s makes 198,001 points of 100"):
        on_grid(tracks, 0.0002)


def test_a_format_of_ones_own(tmp_path):
    """One file adds a reader, which is asked before those that take what nobody else knows."""
    (tmp_path / "plugin.py").write_text(PLUGIN)
    (tmp_path / "walk.csv").write_text("#!pipes\n0.0|7|1000|2000\n0.4|7|1500|2000\n")
    from neurosym_jax.plugins import load_plugin

    load_plugin(str(tmp_path / "plugin.py"))
    try:
        assert sniff(tmp_path / "walk.csv") == "pipes"
        (tracks,) = read_any(tmp_path / "walk.csv", ReadOptions(unit="mm"))
        assert tracks.position.tolist() == [[1, 2], [1.5, 2]]
        assert tracks.reading is not None
        assert (tracks.reading.format, tracks.reading.rows) == ("pipes", 2)
        windows = windows_from(tmp_path / "walk.csv", 1, 1, min_agents=1)
        assert windows.reading[0].format == "pipes"
        with pytest.raises(InputError, match="--fps is of no use for tracks between pipes"):
            read_any(tmp_path / "walk.csv", ReadOptions(fps=25))
        register_format("twin")(FORMATS["pipes"])
        with pytest.raises(InputError, match="say --format pipes or --format twin"):
            sniff(tmp_path / "walk.csv")
        (tracks,) = read_any(tmp_path / "walk.csv", ReadOptions(format="pipes,shift=10"))
        assert tracks.position[0].tolist() == [1010, 2010]
        with pytest.raises(InputError, match=r"walk\.csv: unknown field 'shfit' for Pipes"):
            read_any(tmp_path / "walk.csv", ReadOptions(format="pipes,shfit=10"))
    finally:
        for name in ("pipes", "twin"):
            FORMATS.pop(name, None)
    with pytest.raises(InputError, match="unknown format 'pipes': there are"):
        read_any(tmp_path / "walk.csv", ReadOptions(format="pipes"))


def test_what_a_head_says():
    head = Head("# x\n0 1 2 3\n1 1 2 3 # x\n\n2 1 2")
    assert head.rows.tolist() == [[0, 1, 2, 3], [1, 1, 2, 3]]
    assert Head("0;1;2,5;3").columns == 0
    assert [Head(line).named for line in ("t,id", "0 1 2", "{", "1,5 2", "\x00abc", "")] == [
        *(True, False, True, False, False, False)
    ]


def test_windows_in_one_call():
    stamp = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.3, 80))
    walk = make_tracks("walk", stamp, np.ones(80, int), np.stack([stamp, stamp], 1))
    windows = windows_from(walk, 4, 4, period=0.2, min_agents=1)
    assert windows.period == 0.2
    steps = np.diff(windows.position[:, 4:, 0])
    np.testing.assert_allclose(steps, 0.2, atol=1e-9)
    assert windows_from([walk], 4, 4, min_agents=1).period == 0.4


def test_a_gzip_bomb_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("neurosym_jax.data.text.UNPACKED", (1_000_000, 10))
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"0 1 2 3\n" * 400_000))
    with pytest.raises(InputError, match=r"a\.csv\.gz: unpacks to more than 1,000,000 bytes"):
        read_any(tmp_path / "a.csv.gz")
