"""Files that are replaced whole, settings of the process, and tasks on a Dask cluster."""

import contextlib
import hashlib
import importlib.metadata
import json
import os
import stat
import sys
from unittest import mock

import jax
import numpy as np
import pytest

from neurosym_jax.data.recordings import Synthetic
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import (
    Settings,
    baseline,
    evaluate_tests,
    make_test,
)
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.scores import score_forecaster
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.plugins import load_plugin
from neurosym_jax.runtime import process
from neurosym_jax.runtime.files import (
    folder_digest,
    new_folder,
    refuse_unwritable,
    write_json,
    write_text,
)
from neurosym_jax.runtime.process import (
    available_memory,
    cache_folder,
    code_version,
    cpu_cores,
    provenance,
    run_environment,
    tune,
)
from neurosym_jax.runtime.workers import cluster_map, map_for, process_map
from tests.repository import SMALL, exhaustive, run_python


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "new/folder/rows.json"
    write_json(path, {"a": [1, 2.5]})
    assert json.loads(path.read_text()) == {"a": [1, 2.5]}
    write_text(path, "other")
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"ade": float("nan")})
    assert path.read_text() == "other"
    assert [entry.name for entry in path.parent.iterdir()] == ["rows.json"]
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


def test_a_digest_is_of_names_and_of_where_each_file_ends(tmp_path):
    digests = set()
    for first, second in (("a", "b"), ("a", "c")):
        for texts in (("12", "3"), ("1", "23"), ("123", "")):
            folder = tmp_path / str(len(digests))
            folder.mkdir()
            for name, text in zip((first, second), texts):
                (folder / name).write_text(text)
            digests.add(folder_digest(folder))
            assert folder_digest(folder, second) != folder_digest(folder)
    assert len(digests) == 6


def test_unwritable_paths_are_refused_beforehand(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file/rows.json", tmp_path / ("x" * 300)):
        for refuse in (refuse_unwritable, lambda path: write_text(path, "text")):
            with pytest.raises(InputError, match="cannot be written"):
                refuse(path)
    refuse_unwritable(tmp_path / "new/rows.json")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    """After an error of the caller; `test_faults` has those of the disk."""
    with contextlib.suppress(RuntimeError), new_folder(tmp_path / "made") as beside:
        (beside / "within").mkdir()
        (beside / "within/file").write_text("text")
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    (tmp_path / "made").mkdir()
    with pytest.raises(InputError, match="already there"):
        new_folder(tmp_path / "made")


KEPT_IN = """
import os, sys, jax
from neurosym_jax.runtime.process import enable_compilation_cache
for words in sys.argv[1:]:
    os.environ.update(dict(word.split("=") for word in words.split()))
    jax.config.update("jax_compilation_cache_dir", None)
    enable_compilation_cache()
    print(jax.config.jax_compilation_cache_dir)
"""


def test_programs_are_kept_by_threads_and_never_where_others_may_write(tmp_path):
    """Whoever writes there runs code, and programs of other threads have other bits."""
    own = tmp_path / "neurosym_jax"
    own.mkdir()
    (own / "xla-threads-3").symlink_to(tmp_path)
    cases = ("NPROC=1", "NPROC=2", "NPROC=3", "NPROC=1 NEUROSYM_NO_CACHE=1")
    done = run_python("-c", KEPT_IN, *cases, XDG_CACHE_HOME=str(tmp_path))
    kept = [str(own / "xla-threads-1"), str(own / "xla-threads-2"), "None", "None"]
    assert done.stdout.split() == kept


def test_a_report_says_which_files_it_is_of(tmp_path):
    for name, text in (("walk.txt", "0 1 2 3"), ("model/config.json", "{}")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    data, model = tmp_path / "walk.txt", tmp_path / "model"
    facts = provenance([data], [model])
    digests = [
        {str(path): hashlib.sha256(path.read_bytes()).hexdigest()}
        for path in (data, model / "config.json")
    ]
    assert [facts["data"], facts["checkpoints"]] == digests


@pytest.mark.parametrize("given", ["", "--xla_cpu_enable_fast_math=false"])
def test_vectors_are_wide_unless_the_user_said_otherwise(monkeypatch, given):
    monkeypatch.setenv("MALLOC_ARENA_MAX", "2")  # Leaves this process's memory alone.
    monkeypatch.setenv("XLA_FLAGS", given)
    tune()
    is_known = jax.__version_info__[:2] == (0, 10)
    assert os.environ["XLA_FLAGS"].startswith(given)
    assert ("--xla_cpu_prefer_vector_width=512" in os.environ["XLA_FLAGS"]) == is_known
    flag = "--xla_cpu_prefer_vector_width=256"
    monkeypatch.setenv("XLA_FLAGS", flag)
    tune()
    assert os.environ["XLA_FLAGS"] == flag


def test_without_a_home_nothing_is_kept(monkeypatch, tmp_path):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("pathlib.Path.home", lambda: tmp_path)
    assert cache_folder() == tmp_path / ".cache/neurosym_jax"
    monkeypatch.setattr("pathlib.Path.home", mock.Mock(side_effect=RuntimeError))
    assert cache_folder() is None
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cache_folder() is None


def test_the_environment_is_json_and_knows_the_threads(monkeypatch):
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    monkeypatch.setenv("NPROC", "3")
    environment = run_environment()
    assert json.loads(json.dumps(environment)) == environment
    assert (environment["threads"], environment["jax"]) == (3, jax.__version__)
    commit = code_version()
    assert commit is None or commit == commit.strip() != ""


def test_a_clone_that_is_not_installed_has_a_provenance_too(monkeypatch):
    """A report came to nothing at its end, after all evaluations."""
    found = importlib.metadata.version

    def version(name):
        if name == "neurosym-jax":
            raise importlib.metadata.PackageNotFoundError(name)
        return found(name)

    assert provenance()["version"] == found("neurosym-jax")
    monkeypatch.setattr(importlib.metadata, "version", version)
    assert provenance()["version"] == "not installed"


FORKED = """
import os, sys
import numpy as np
import neurosym_jax as nj

def forecast():
    model = nj.load_model(sys.argv[1])
    for function, scene in ((nj.predict, SCENE), (nj.predict_scenes, [SCENE])):
        try:
            print(len(function(model, scene, samples=2)), flush=True)
        except nj.InputError as error:
            print(error, flush=True)

SCENE = np.zeros((1, 8, 2))
for turn in range(2):
    if not (child := os.fork()):
        forecast()
        os._exit(0)
    os.waitpid(child, 0)
    forecast()
"""


@pytest.mark.slow
def test_a_child_forked_after_a_forecast_is_told_how_to_start_instead():
    """Forked before the first one it forecasts."""
    done = run_python("-W", "ignore", "-c", FORKED, SMALL)
    first, second = done.stdout.splitlines()[:4], done.stdout.splitlines()[4:]
    assert first == ["2", "1", "2", "1"], done.stdout + done.stderr
    assert all("'spawn' or 'forkserver'" in line for line in second[:2])
    assert second[2:] == ["2", "1"]


def test_an_evaluation_of_too_many_samples_names_what_to_lower():
    assert 1e8 < available_memory() < 1e14
    batches = make_batches(cut_windows(Synthetic().recordings("cross-path"), 8, 8))
    with pytest.raises(InputError, match="ask for fewer samples"):
        score_forecaster(
            ConstantVelocitySampled(Lengths()), (), batches, samples=10**9, seed=0
        )


@contextlib.contextmanager
def dask_map():
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**options) as cluster,
        cluster_map(cluster.scheduler_address) as run,
    ):
        yield run


@pytest.mark.slow
@pytest.mark.parametrize("elsewhere", [exhaustive(dask_map), process_map])
def test_tasks_have_plugins_and_rows_are_the_same(tmp_path, elsewhere):
    """Real processes: tasks have the caller's plugins, and rows are the same."""
    code = "import os\ndef place(x):\n    return 2 * x, os.getpid(), len(os.sched_getaffinity(0))\n"
    (tmp_path / "doubling.py").write_text(code)
    load_plugin(str(tmp_path / "doubling.py"))
    (*_, plugin) = (name for name in sys.modules if name.startswith("doubling_"))
    double = sys.modules[plugin].place
    stamp, person = np.divmod(np.arange(40), 2)
    tracks = make_tracks(
        "walk", stamp * 0.4, person, np.stack([stamp, 1.0 * person], 1)
    )
    entries = [(None, baseline("constant_velocity_sampled", 4, 2))]
    tests = [make_test(Case(name, 4, 2), entries, [tracks]) for name in "ab"]
    settings = Settings(samples=2)
    with elsewhere() as run:
        (first, process, cores), (other, *_) = run(double, [21, 4])
        assert (first, other) == (42, 8)
        assert process != os.getpid()
        assert elsewhere is dask_map or cores == 1
        results = list(evaluate_tests(tests, settings, run))
    assert [result.test_set.dataset for result in results] == ["a", "b"]
    for result, other in zip(results, evaluate_tests(tests, settings), strict=True):
        for name in ("joint_ade", "joint_ade_low", "joint_ade_high"):
            assert result.row[name] == pytest.approx(other.row[name])


def test_a_killed_process_ends_in_a_line():
    with pytest.raises(InputError, match=r"was killed.*NPROC=1"), process_map() as run:
        list(run(os._exit, [1]))


def test_processes_start_for_many_tasks_only(monkeypatch):
    """None starts before the context is entered."""
    monkeypatch.delenv("NPROC", raising=False)
    assert isinstance(map_for(7), contextlib.nullcontext)
    one_core = cpu_cores() == 1
    assert isinstance(map_for(8), contextlib.nullcontext) == one_core
    monkeypatch.setenv("NPROC", "1")
    with map_for(99) as run:
        assert run is None


LIMITED = """
import resource, sys
from neurosym_jax.runtime.process import available_memory, refuse_beyond_memory
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 10**9, size + 10**9))
print(available_memory())
refuse_beyond_memory("this", 0.9e9, "ask for less")
refuse_beyond_memory("this", 1.1e9, "ask for less")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits are read from /proc")
def test_the_limit_of_the_process_is_seen():
    done = run_python("-c", LIMITED, check=False)
    assert 0.9e9 < float(done.stdout) <= 1e9
    assert "this needs some 1.1 GB of memory, and 1.0 GB are free" in done.stderr


@pytest.mark.parametrize(
    ("line", "folder", "names"),
    [
        ("0::/a/b", "a", ("memory.max", "memory.current")),
        ("0::/not/seen/inside", "", ("memory.max", "memory.current")),
        (
            "7:cpu,memory:/a/b",
            "memory/a",
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        ),
    ],
)
def test_the_limit_of_a_container_is_seen(tmp_path, line, folder, names):
    """Of any group around the process's own, less what is used, with pages of files."""
    own, place = tmp_path / "own", tmp_path / folder
    own.write_text(f"3:pids:/a\n{line}\n")
    place.mkdir(parents=True, exist_ok=True)
    assert process._of_groups(own, tmp_path) == float("inf")
    for name, number in zip(names, ("1000", "700")):
        (place / name).write_text(f"{number}\n")
    (place / "memory.stat").write_text("anon 600\ninactive_file 50\n")
    assert process._of_groups(own, tmp_path) == 350
    for unlimited in ("max", str(2**63 - 4096)):
        (place / names[0]).write_text(unlimited)
        assert process._of_groups(own, tmp_path) == float("inf")
