"""Sources by name of the data set, of files, and of what was downloaded."""

import contextlib
import functools
import itertools
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.commands.download import published_files, run
from neurosym_jax.data.recordings import GENERAL, EthUcy, Synthetic, find, open_source
from neurosym_jax.data.tracks import PERIOD, resample
from neurosym_jax.errors import InputError
from neurosym_jax.simulation import scenarios


def test_each_file_is_a_scene(tmp_path):
    for name in ("b.txt", "a.csv"):
        (tmp_path / name).write_text("0 1 2 3\n1 1 2 3\n")
    source = open_source(str(tmp_path))
    assert source.scenes == ("a", "b")
    (tracks,) = source.recordings("b")
    assert tracks.recording == "b"
    named, read_by_path = source.files(["a", str(tmp_path / "a.csv")])
    assert_array_equal(named.position, read_by_path.position)
    with pytest.raises(InputError, match="c: no such file, nor a recording among a, b"):
        source.files(["a", "c"])
    with pytest.raises(InputError, match="unknown data set 'eth': there are a, b"):
        source.recordings("eth")


def test_leave_one_recording_out(tmp_path):
    for name, first in (("a", 0), ("b", 100), ("c", 200)):
        rows = [
            f"{first + n} {who} {first + n / 2} {who}"
            for n, who in itertools.product(range(10), (1, 2))
        ]
        (tmp_path / f"{name}.txt").write_text("\n".join(rows))
    (tmp_path / "d.txt").write_text("0 1 2 3\n")
    with pytest.raises(
        InputError, match="a: the only recording, so nothing is left to train"
    ):
        open_source(tmp_path / "a.txt").recordings("a", "train")
    source = open_source(str(tmp_path))
    positions = {"train": {}, "val": {}, "test": {}}
    for split, by_recording in positions.items():
        for tracks in source.recordings("b", split):
            first = tracks.position[tracks.id == 1]
            by_recording[tracks.recording] = first[:, 0].tolist()
    assert positions == {
        "train": {
            "a": [n / 2 for n in range(10)],
            "c": [200 + n / 2 for n in range(10)],
            "d": [2],
        },
        "val": {},  # A part of the others is kept for it where they are prepared.
        "test": {"b": [100 + n / 2 for n in range(10)]},
    }


def test_simulations_of_each_split_have_their_own_seeds():
    seeds = {"test": range(2), "val": range(100, 102), "train": range(200, 208)}
    for split, split_seeds in seeds.items():
        recordings = Synthetic().recordings("cross-path", split)
        for tracks, seed in zip(recordings, split_seeds, strict=True):
            expected = resample(scenarios.simulate("cross-path", seed), PERIOD)
            np.testing.assert_array_equal(tracks.position, expected.position)


def test_there_is_no_test_set_of_all():
    with pytest.raises(InputError, match="general is for models of real people"):
        Synthetic().recordings(GENERAL, "val")
    with pytest.raises(InputError, match="unknown data set 'general'"):
        Synthetic().recordings(GENERAL, "test")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), r"no \.txt, \.csv.* file in it"),
        (("general.txt",), "called alike, or one general"),
        (("a.txt", "a.csv"), "two files are called alike"),
    ],
)
def test_refused(tmp_path, names, message):
    for name in names:
        (tmp_path / name).write_text("0 1 2 3\n")
    with pytest.raises(InputError, match=message):
        open_source(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        open_source(tmp_path / "absent")


CSV = "Frame,Time,Helmet_1 X,Helmet_1 Y,Helmet_1 Z\n1,0.0,1000,2000,3\n2,0.01,1000,2000,3\n"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The folder of the user's data."""
    monkeypatch.setenv("NEUROSYM_DATA", str(tmp_path / "home"))
    return tmp_path / "home"


class Handler(SimpleHTTPRequestHandler):
    """Answers each request as the next step of the server's script says."""

    server: Any

    def log_message(self, format, *args):
        pass

    def do_GET(self):
        self.step = next(self.server.script)
        self.path = {"absent": "/absent"}.get(self.step, self.path)
        super().do_GET()

    def copyfile(self, source, outputfile):
        body = source.read()
        with contextlib.suppress(OSError):  # The client may have given up.
            outputfile.write(
                {"corrupt": bytes(len(body)), "cut": body[:1000]}.get(self.step, body)
            )


@pytest.fixture
def served(shared, tmp_path, monkeypatch):
    """Address of a copy of what is published, on a server that behaves as the script says."""
    monkeypatch.setattr("pooch.core.time.sleep", lambda _: None)
    folders = {"eth-ucy": "data/eth_ucy", "sgan-checkpoints": "checkpoints"}
    for collection, folder in folders.items():
        for name, row in published_files(collection).items():
            path = tmp_path / "site" / row["address"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.symlink_to(shared / folder / name)
    with contextlib.ExitStack() as stack:

        def serve(*script):
            handler = functools.partial(Handler, directory=tmp_path / "site")
            server: Any = stack.enter_context(
                ThreadingHTTPServer(("127.0.0.1", 0), handler)
            )
            server.script = itertools.chain(script, itertools.repeat(script[-1]))
            threading.Thread(
                target=server.serve_forever, args=(0.01,), daemon=True
            ).start()
            stack.callback(server.shutdown)
            return f"http://127.0.0.1:{server.server_port}"

        yield serve


def names(folder):
    return sorted(
        str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()
    )


def test_over_http_and_found_without_being_told(served, home, capsys):
    for collection, count in (("eth-ucy", 24), ("sgan-checkpoints", 20)):
        mirror = served("cut", "corrupt", "whole")
        for came in (count, 0):
            assert run(collection, mirror=mirror) == 0
            assert capsys.readouterr().out.endswith(f", {came} of them fetched now\n")
        assert names(home / collection) == sorted(published_files(collection))
    source = open_source(Path("eth-ucy"))
    assert isinstance(source, EthUcy)
    assert source.folder == home / "eth-ucy"
    assert open_source(None, "zara1") == open_source(None, None, "eth") == source
    for absent in (open_source(None), open_source(None, "cross-path", "eth")):
        assert isinstance(absent, Synthetic)
    path = Path("sgan-models/eth_8_model.pt")
    assert find(path) == home / "sgan-checkpoints" / path


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        ("absent", "404 Client Error"),
        ("corrupt", "hash of downloaded file"),
        ("cut", "hash|Incomplete"),
    ],
)
def test_what_breaks_off_is_not_there_and_goes_on(served, home, capsys, step, reason):
    address = served("whole", "whole", "whole", step)
    with pytest.raises(
        InputError, match=f"({reason}).* run this again, or name"
    ) as caught:
        run("eth-ucy", mirror=address, timeout=0.5)
    assert str(caught.value).startswith(f"{address}/")
    assert "\n" not in str(caught.value)
    assert not (home / "eth-ucy").exists()
    assert len(names(home)) == 3
    with pytest.raises(
        InputError, match="fetch it once: python -m neurosym_jax download eth-ucy"
    ):
        open_source(None, "eth")
    assert run("eth-ucy", mirror=served("whole")) == 0
    assert "21 of them fetched now" in capsys.readouterr().out


def test_what_is_there_is_checked_and_never_overwritten(served, tmp_path, capsys):
    options: Any = {"to": tmp_path / "there", "mirror": served("whole")}
    run("eth-ucy", **options)
    assert f"export NEUROSYM_DATA={tmp_path / 'there'}" in capsys.readouterr().out
    folder = tmp_path / "there/eth-ucy"
    (folder / "all/biwi_eth.txt").unlink()
    (folder / "mine.txt").write_text("mine")
    assert run("eth-ucy", **options) == 0
    assert "1 of them fetched now" in capsys.readouterr().out
    (folder / "val/biwi_eth_val.txt").write_text("mine")
    with pytest.raises(
        InputError, match=r"biwi_eth_val\.txt: is not the published file"
    ):
        run("eth-ucy", **options)
    assert {
        (folder / name).read_text() for name in ("mine.txt", "val/biwi_eth_val.txt")
    } == {"mine"}


def test_thor_by_hand(home, capsys):
    assert run("thor") == 2
    out = capsys.readouterr().out
    assert "https://zenodo.org/records/3382145" in out
    assert f"put the recordings into {home / 'thor'}" in out
    (home / "thor").mkdir(parents=True)
    (home / "thor/Exp_1_run_1_6D.csv").write_text(CSV)
    (home / "thor/broken.csv").write_text("1,2\n")
    assert run("thor") == 0
    out = capsys.readouterr().out
    assert "Exp_1_run_1_6D.csv: QTM export" in out
    assert "broken.csv: " in out
    assert open_source(None, "Exp_1_run_1_6D").recordings("Exp_1_run_1_6D")[
        0
    ].id.tolist() == [1]
