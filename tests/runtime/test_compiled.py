"""Compiled programs between processes: a damaged one is noticed, replaced and changes nothing."""

import errno
import os

import numpy as np
import pytest

from neurosym_jax.runtime.compiled import SealedCache
from tests.repository import SMALL, run_python

FORECAST = """
import sys
import numpy as np
import neurosym_jax as nj
nj.runtime.enable_compilation_cache()
steps = np.arange(8.0)[:, None] * [0.4, 0.1]
observed = np.stack([steps, 4 - steps])
print(nj.predict(nj.load_model(sys.argv[1]), observed, samples=2).tobytes().hex())
"""


@pytest.fixture
def cache(tmp_path):
    cache = SealedCache(tmp_path / "programs")
    cache.put("a", bytes(range(200)))
    return cache


def test_a_flipped_bit_anywhere_and_a_torn_entry_are_removed_and_told_once(
    cache, capsys
):
    file = cache._path / "a.program"
    content = file.read_bytes()
    damaged = [content[:length] for length in (0, 31, 32, len(content) - 1)]
    for bit in range(8 * len(content)):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        damaged.append(bytes(flipped))
    for program in damaged:
        file.write_bytes(program)
        assert cache.get("a") is None
        assert not file.exists()
    cache.put("a", b"new")
    assert cache.get("a") == b"new"
    warning = f"warning: {cache._path}: damaged programs are compiled again\n"
    assert capsys.readouterr().err == warning


def test_an_entry_of_another_key_is_none_of_this_one(cache):
    (cache._path / "a.program").rename(cache._path / "b.program")
    assert cache.get("a") is None
    assert cache.get("b") is None
    assert not list(cache._path.iterdir())


def test_a_folder_that_is_only_read_is_used(cache, monkeypatch):
    """As an image's, whose times of use cannot be written."""
    cache.put("key", b"program")

    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "utime", refuse)
    assert cache.get("key") == b"program"


def test_beyond_the_limit_what_was_used_least_recently_goes(cache):
    cache.limit = 3 * (200 + 32)
    (cache._path / "other-version").write_bytes(bytes(50))
    os.utime(cache._path / "other-version", (1, 1))
    for at, key in enumerate(["b", "c"]):
        cache.put(key, bytes(200))
        os.utime(cache._path / f"{key}.program", (10 + at, 10 + at))
    assert cache.get("a")
    cache.put("d", bytes(200))
    assert {path.name for path in cache._path.iterdir()} == {
        f"{key}.program" for key in "acd"
    }
    assert [cache.get("a"), cache.get("b")] == [bytes(range(200)), None]


def test_a_disk_that_fails_costs_no_more_than_time(cache, tmp_path):
    def full(*_):
        raise OSError(28, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", full)
        patch.setattr("pathlib.Path.replace", full)
        cache.put("b", b"1")
    assert [path.name for path in cache._path.iterdir()] == ["a.program"]
    (cache._path / "c.program").mkdir()
    assert cache.get("c") is None
    cache.put("c", b"1")
    (tmp_path / "file").touch()
    nowhere = SealedCache(tmp_path / "file/programs")
    nowhere.put("a", b"1")
    assert nowhere.get("a") is None


@pytest.mark.slow
def test_a_forecast_from_damaged_programs_has_the_same_bits_and_heals_them(tmp_path):
    def forecast():
        done = run_python("-c", FORECAST, SMALL, XDG_CACHE_HOME=str(tmp_path))
        return done.stdout, done.stderr

    first = forecast()
    files = sorted(tmp_path.rglob("*.program"))
    assert len(files) > 2, "nothing was kept"
    rng = np.random.default_rng(0)
    for number, file in enumerate(files):
        content = bytearray(file.read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content[: len(content) // 2] if number % 5 == 4 else content)
    second, third = forecast(), forecast()
    assert second[0] == first[0] == third[0]
    assert second[1].count("damaged programs are compiled again") == 1
    assert first[1] == third[1] == ""
    assert sorted(tmp_path.rglob("*.program")) == files
