"""The package as a wheel, installed in a place of its own and used in an empty folder."""

import hashlib
import itertools
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile

import pytest
from setuptools.build_meta import build_editable

from tests.repository import ROOT, slow

SOURCES = (
    "neurosym_jax",
    "neurosym_robot",
    "checkpoints",
    "pyproject.toml",
    "setup.py",
)
SOURCES += ("README.md", "LICENSE")
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
TRAIN = (
    "--steps",
    "2",
    "--out",
    "run",
    "--dataset",
    "cross-path",
    "--family",
    "anchor_table",  # Compiled in a second.
    "--set",
    "batch_scenes=4",
)
ENTRANCE = ("README.md", "docs/index.md")
"""What is read first, and run whenever tests are."""
WALK = [
    f"{0.4 * t:.1f},{who},{0.3 * t + who},{2 * who}"
    for t, who in itertools.product(range(20), (0, 1))
]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder of an installed wheel; the dependencies are those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    (folder / "source").mkdir()  # for a build writes beside its sources
    for name in SOURCES:
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, folder / "source")
        else:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / "source" / name, ignore=ignored)
    build = (
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        folder,
        folder / "source",
    )
    subprocess.run([*PIP, *build], check=True)
    (wheel,) = folder.glob("*.whl")
    assert 4 < wheel.stat().st_size / 2**20 < 8  # MiB, with every model that ships.
    place = folder / "installed"
    subprocess.run([*PIP, "install", "--no-deps", "--target", place, wheel], check=True)
    return place


@pytest.mark.slow
def test_a_source_distribution_has_the_same_bytes_at_any_time(installed, tmp_path):
    source = installed.parent / "source"
    digests = []
    for time in (1_000_000_000, 1_500_000_000):
        for path in source.rglob("*.py"):
            os.utime(path, (time, time))
        command = [sys.executable, "setup.py", "-q", "sdist", "--dist-dir", tmp_path]
        subprocess.run(command, cwd=source, check=True, capture_output=True)
        (archive,) = tmp_path.glob("*.tar.gz")
        digests.append(hashlib.sha256(archive.read_bytes()).hexdigest())
    assert digests[0] == digests[1]
    with tarfile.open(archive) as entries:
        names = entries.getnames()
    root = names[0]
    assert {f"{root}/PKG-INFO", f"{root}/neurosym_jax/scene.py"} < set(names)


def test_an_editor_finds_an_editable_install(installed, tmp_path, monkeypatch):
    """It is a line of sys.path: pyright follows no import hooks."""
    monkeypatch.chdir(installed.parent / "source")
    name = build_editable(str(tmp_path))
    with zipfile.ZipFile(tmp_path / name) as wheel:
        (line,) = [name for name in wheel.namelist() if "editable" in name]
        assert line.endswith(".pth")
        assert wheel.read(line).decode().strip() == str(installed.parent / "source")


@pytest.mark.parametrize(
    ("places", "least"),
    [(ENTRANCE, 3), slow((*ENTRANCE[:1], "docs", "studies/pages"), 25)],
)
def test_what_pages_show_runs(installed, tmp_path, places, least):
    """Every block of Python and every command that needs nothing else, with what they print."""
    pytest.importorskip("sybil", reason="pages need the extra test")
    environment = os.environ | {
        "PYTHONPATH": str(installed),
        "NEUROSYM_DATA": str(tmp_path / "no"),
    }
    pages = [
        page
        for place in places
        for page in (sorted((ROOT / place).glob("*.md")) or [ROOT / place])
    ]
    command = [sys.executable, "-P", ROOT / "tests" / "pages.py", *pages]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    count = re.search(
        r"ran (\d+) blocks and commands of (\d+) pages, 0 failed", done.stdout
    )
    assert count
    assert int(count[1]) >= least
    assert (tmp_path / "results/figures/tracks_my_tracks.png").is_file()


@pytest.mark.slow
def test_everything_works_outside_a_clone(installed, tmp_path):
    (tmp_path / "walk.csv").write_text("\n".join(["t,id,x,y", *WALK]))
    environment = {
        name: v for name, v in os.environ.items() if not name.startswith("NEUROSYM_")
    }
    environment |= {
        "PYTHONPATH": str(installed),
        "NEUROSYM_DATA": str(tmp_path / "data"),
    }
    neurosym = installed / "bin" / "neurosym"
    python = "import neurosym_jax as nj; print(nj.__file__, nj.load_model('sgan_eth_8').name)"
    commands = {
        "train": [neurosym, "train", *TRAIN],
        "replay": [neurosym, "replay", "walk.csv", "--model", "neurosym_zara1_8"],
        "help": [neurosym, "--help"],
        "models": [neurosym, "models", "--all"],
        "python": [sys.executable, "-c", python],
    }
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    options |= {"cwd": tmp_path, "env": environment}
    running = {
        name: subprocess.Popen(command, **options) for name, command in commands.items()
    }
    outputs = {
        name: process.communicate(timeout=300)[0] for name, process in running.items()
    }
    for name, process in running.items():
        assert process.returncode == 0, outputs[name]
    assert f"{installed}/neurosym_jax/__init__.py SGAN" in outputs["python"]
    assert "evaluate" in outputs["help"]
    assert "neurosym_simulations_8" in outputs["models"]
    assert f"{installed}/neurosym_jax/checkpoints" in outputs["models"]
    assert (tmp_path / "run" / "model" / "params.safetensors").is_file()
    assert (installed / "neurosym_jax" / "py.typed").is_file()
    assert re.search(r"(?m)^neurosym_zara1_8  ", outputs["replay"]), outputs["replay"]
