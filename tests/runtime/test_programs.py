"""Programs kept whole: the same numbers, and what is damaged or stale is computed again."""

import concurrent.futures
import dataclasses
import functools
import importlib
import io
import os
import pickle
import shutil
import threading
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax import plugins
from neurosym_jax.models.baselines import ConstantVelocity
from neurosym_jax.models.forecaster import NoiseSpec
from neurosym_jax.runtime import programs
from neurosym_jax.runtime.compiled import private_folder
from neurosym_jax.runtime.programs import Unnamed, program, spelled
from neurosym_jax.scene import make_scene
from tests.repository import SMALL, run_python

FORECAST = """
import os, sys
import jax
import numpy as np
import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_plugin
if os.environ.get("SWITCH"):
    jax.config.update(os.environ["SWITCH"], True)
traced = []
listen = lambda event, seconds, **of: traced.append((event, of.get("fun_name")))
jax.monitoring.register_event_duration_secs_listener(listen)
nj.runtime.enable_compilation_cache()
for plugin in sys.argv[2:]:
    load_plugin(plugin)
steps = np.arange(8.0)[:, None] * [0.4, 0.1]
observed = np.stack([steps, 4 - steps])
forecast = nj.predict(nj.load_model(sys.argv[1]), observed, samples=2)
names = {name for event, name in traced if event.endswith("jaxpr_trace_duration")}
print(forecast.tobytes().hex(), *sorted(names))
"""
PLUGIN = """
import dataclasses
from neurosym_jax.models.sgan.network import register_pooling
from neurosym_jax.models.sgan.network import PoolNet

@register_pooling("mine")
@dataclasses.dataclass(frozen=True)
class Mine(PoolNet):
    pass
"""


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A folder of programs, in use for one test."""
    monkeypatch.setattr(programs, "_cache", None)
    # Of tests that registered something before.
    monkeypatch.setattr(plugins, "_additions", [])
    programs.keep_whole(tmp_path / "programs")
    # Else JAX would take programs from its own cache, which cannot be kept again.
    before = jax.config.jax_enable_compilation_cache
    jax.config.update("jax_enable_compilation_cache", False)
    jax.experimental.compilation_cache.compilation_cache.reset_cache()
    yield tmp_path / "programs"
    jax.config.update("jax_enable_compilation_cache", before)
    jax.experimental.compilation_cache.compilation_cache.reset_cache()


def scaled(factor, scene, key, state):
    """A function of a static number, a scene, a key and a state that is a tree."""
    noise = jax.random.normal(key, scene.observed.shape)
    total = factor * jnp.tanh(scene.observed) + noise
    return total, {"state": state["a"] + total.sum(), "none": None}


scaled.__module__ = "neurosym_jax.tests"
ARGUMENTS = (
    make_scene(np.random.default_rng(0).normal(size=(3, 8, 2))),
    jax.random.key(7),
    {"a": np.ones(4, np.float32)},
)


def newly(function=scaled, static=(0,), **options):
    """The program as another process has it: with nothing in memory."""
    return program(static, **options)(function)


def numbers(result):
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(result)]


def counted(function):
    """`function` and the list of its traces."""
    traces = []

    @functools.wraps(function)
    def traced(*arguments):
        traces.append(arguments)
        return function(*arguments)

    return traced, traces


def test_a_kept_program_has_the_same_bits_and_is_not_traced(kept):
    expected = jax.jit(scaled, static_argnums=0)(2.0, *ARGUMENTS)
    function, traces = counted(scaled)
    first = newly(function)(2.0, *ARGUMENTS)
    assert len(traces) == 1
    assert len(list(kept.iterdir())) == 2
    again = newly(function)
    second, third = again(2.0, *ARGUMENTS), again(2.0, *ARGUMENTS)
    assert len(traces) == 1
    assert jax.tree.structure(second) == jax.tree.structure(expected)
    assert numbers(first) == numbers(second) == numbers(third) == numbers(expected)


def test_other_source_that_computes_the_same_is_traced_but_not_compiled(
    kept, monkeypatch
):
    newly()(2.0, *ARGUMENTS)
    files = set(kept.iterdir())
    monkeypatch.setattr(programs, "_source", lambda: "a comment more")
    function, traces = counted(scaled)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax.stages.Lowered, "compile", None)
        result = newly(function)(2.0, *ARGUMENTS)
    assert len(traces) == 1
    assert numbers(result) == numbers(newly()(2.0, *ARGUMENTS))
    assert len(set(kept.iterdir()) - files) == 1

    @functools.wraps(scaled)
    def newer(*arguments):
        return scaled(*arguments)[0] + 1

    monkeypatch.setattr(programs, "_source", lambda: "another sum")
    changed = newly(newer)(2.0, *ARGUMENTS)
    np.testing.assert_allclose(changed, result[0] + 1, rtol=1e-6)


def test_donated_buffers_are_reused_by_a_kept_program_too(kept):
    def step(state):
        return state + 1.0

    step.__module__, step.__qualname__ = "neurosym_jax.tests", "step"
    for _ in range(2):
        state = jnp.arange(4.0)
        # With checks of NaN JAX keeps the buffers.
        with jax.debug_nans(False):
            moved = newly(step, (), donate_argnums=0)(state)
        np.testing.assert_array_equal(moved, np.arange(4.0) + 1)
        assert state.is_deleted()


def test_what_differs_in_any_argument_is_another_program(kept):
    scene, key, state = ARGUMENTS
    longer = make_scene(np.zeros((4, 8, 2)))
    variants = [
        (2.0, scene, key, state),
        (3.0, scene, key, state),
        (2, scene, key, state),
        (2.0, longer, key, state),
        (2.0, scene.replace(period=0.5), key, state),
        (2.0, scene.replace(origin=None), key, state),
        (2.0, scene, key, {"a": np.ones(4, np.float16)}),
        (2.0, scene, key, {"a": np.ones(5, np.float32)}),
    ]
    for count, arguments in enumerate(variants, 1):
        expected = jax.jit(scaled, static_argnums=0)(*arguments)
        assert numbers(newly()(*arguments)) == numbers(expected)
        # Each has a place, where equal programs share an executable.
        places = [file for file in kept.iterdir() if file.stat().st_size < 100]
        assert len(places) == count


def first_of(used, unused):
    """The second argument stands in no lowered program, but its shape is asked for."""
    return used + 1


def test_an_argument_that_is_not_used_has_its_shape_in_the_key(kept):
    used = np.zeros(3, np.float32)
    for size in (2, 5):
        result = newly(first_of, ())(used, np.zeros(size, np.float32))
        assert numbers(result) == numbers(used + 1)


def test_within_a_trace_it_is_a_part_of_the_traced_program(kept):
    scene, key, state = ARGUMENTS
    outer = jax.jit(lambda scene, key: newly()(2.0, scene, key, state)[0])
    np.testing.assert_allclose(
        outer(scene, key), newly()(2.0, *ARGUMENTS)[0], atol=1e-6
    )
    gradient = jax.grad(
        lambda x: newly()(x, scene, key, state)[0].sum(), allow_int=True
    )
    with pytest.raises(ValueError, match="static"):
        gradient(jnp.ones(()))  # A static argument: as of `jax.jit`.


@pytest.mark.parametrize("keeps", ["nothing", "named", "unnamed"])
def test_options_are_those_of_the_static_arguments_and_none_within_a_trace(
    keeps, request, monkeypatch
):
    """XLA refuses an option that it does not know: so it is seen which are used."""
    monkeypatch.setattr(programs, "_cache", None)
    if keeps != "nothing":
        request.getfixturevalue("kept")
    # A path has no name by which another process would know it.
    usual, strange = map(Path if keeps == "unnamed" else str, ("usual", "strange"))

    def options(name: str | Path) -> dict[str, bool]:
        return {"no_such_option": True} if name == strange else {}

    doubling = program((0,), compiler_options=options)
    twice = doubling(lambda name, x: 2 * x)
    assert twice(usual, np.ones(3, np.float32)).tolist() == [2, 2, 2]
    with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option"):
        twice(strange, np.ones(3, np.float32))
    outer = jax.jit(lambda x: twice(strange, x))
    assert outer(np.ones(3, np.float32)).tolist() == [2, 2, 2]
    assert jax.vmap(lambda x: twice(strange, x))(jnp.ones(3)).tolist() == [2, 2, 2]
    assert jax.grad(lambda x: twice(strange, x))(1.0) == 2
    # They were measured on a CPU, and other compilers may refuse them.
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert twice(strange, np.ones(3, np.float32)).tolist() == [2, 2, 2]


def test_threads_that_call_at_once_use_one_program(kept, monkeypatch):
    """Of an argument without a name, so that nothing is kept: `jax.jit` compiles it."""
    jit, threads = jax.jit, 4

    def slow_jit(*arguments, **options):
        time.sleep(0.1)  # Until every thread has asked.
        return jit(*arguments, **options)

    start = threading.Barrier(threads)
    doubled = newly(lambda name, x: 2 * x)
    monkeypatch.setattr(jax, "jit", slow_jit)

    def call(_):
        start.wait()
        return doubled(Path(), np.ones(3, np.float32)).tolist()

    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        assert [*pool.map(call, range(threads))] == threads * [[2, 2, 2]]


def test_500_flipped_bits_and_torn_files_are_never_used(kept, capsys):
    expected = numbers(newly()(2.0, *ARGUMENTS))
    place, file = sorted(kept.iterdir(), key=lambda file: file.stat().st_size)
    content, rng = file.read_bytes(), np.random.default_rng(0)
    used = programs._cache
    linked = place.read_bytes()
    for bit in range(8 * len(linked)):
        flipped = bytearray(linked)
        flipped[bit // 8] ^= 1 << bit % 8
        place.write_bytes(flipped)
        assert used.get(place.stem) is None
    for bit in rng.choice(8 * len(content), 500, replace=False):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        file.write_bytes(flipped)
        assert used.get(file.stem) is None
        assert not file.exists()
    for length in (0, 31, 32, 100, len(content) - 1):
        file.write_bytes(content[:length])
        assert used.get(file.stem) is None
    file.write_bytes(flipped)
    function, traces = counted(scaled)
    assert numbers(newly(function)(2.0, *ARGUMENTS)) == expected
    assert len(traces) == 1
    assert "damaged programs are compiled again" in capsys.readouterr().err
    function, traces = counted(scaled)
    assert numbers(newly(function)(2.0, *ARGUMENTS)) == expected
    assert not traces, "what was damaged was not replaced"


@pytest.mark.parametrize(
    "named",
    [os.system, shutil.rmtree, pickle.loads, ConstantVelocity, jax.jit, np.load, eval],
)
def test_a_sealed_file_that_would_run_code_is_not_read(kept, named):
    newly()(2.0, *ARGUMENTS)
    *_, file = sorted(kept.iterdir(), key=lambda file: file.stat().st_size)
    programs._cache.put(file.stem, pickle.dumps((b"", named)))
    expected = jax.jit(scaled, static_argnums=0)(2.0, *ARGUMENTS)
    function, traces = counted(scaled)
    assert numbers(newly(function)(2.0, *ARGUMENTS)) == numbers(expected)
    assert len(traces) == 1
    with pytest.raises(pickle.UnpicklingError):
        programs._Data(io.BytesIO(pickle.dumps(named))).load()


def test_names_that_a_module_of_jax_imported_are_not_read():
    for module, name in (
        ("jax._src.core", "threading.Thread"),
        ("jax._src.core", "Callable"),
        ("jax._src.compilation_cache", "os.system"),
        ("neurosym_jax.plugins", "Registry"),
        ("neurosym_jax.scene", "np.load"),
    ):
        with pytest.raises((pickle.UnpicklingError, AttributeError)):
            programs._Data(io.BytesIO(b"")).find_class(module, name)


def test_a_stale_key_of_each_kind_is_another_key(kept, monkeypatch):
    def key():
        programs._machine.cache_clear()
        return programs._key("name", (1,), "tree", "shapes")

    keys = [key()]
    assert key() == keys[0]
    for replaced, value in (
        ("_source", lambda: "another source"),
        ("processor", lambda: "another processor"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(programs, replaced, value)
            keys.append(key())
    for variable in programs.VARIABLES:
        with monkeypatch.context() as patch:
            patch.setenv(variable, "--xla_cpu_prefer_vector_width=128")
            keys.append(key())
    with jax.numpy_rank_promotion("warn"):
        keys.append(key())
    with jax.default_matmul_precision("bfloat16"):
        keys.append(key())
    with jax.enable_x64(True):
        keys.append(key())
    version = programs.importlib.metadata.version
    for package in programs.VERSIONED:
        with monkeypatch.context() as patch:
            changed = functools.partial(
                lambda of, name: "0" if name == of else version(name), package
            )
            patch.setattr(programs.importlib.metadata, "version", changed)
            keys.append(key())
    programs._machine.cache_clear()
    assert len(set(keys)) == len(keys)
    assert key() == keys[0]


def test_settings_of_a_thread_have_programs_of_their_own(kept):
    once = newly()
    usual = once(2.0, *ARGUMENTS)[0]
    with jax.enable_x64(True):
        scene, key, state = ARGUMENTS
        wide = scene.replace(observed=scene.observed.astype(np.float64))
        assert once(2.0, wide, key, state)[0].dtype == jnp.float64
    assert once(2.0, *ARGUMENTS)[0].dtype == usual.dtype == jnp.float32


def test_the_source_is_a_part_of_the_key_and_its_change_while_running_keeps_nothing(
    tmp_path, monkeypatch
):
    file = tmp_path / "neurosym_other/runtime/programs.py"
    file.parent.mkdir(parents=True)
    file.write_text("a = 1\n")
    os.utime(file, (1, 1))
    monkeypatch.setattr(programs, "ROOT", tmp_path)
    first = programs._source.__wrapped__()
    assert programs._source.__wrapped__() == first
    file.write_text("a = 2\n")
    with pytest.raises(Unnamed):
        programs._source.__wrapped__()
    os.utime(file, (1, 1))
    second = programs._source.__wrapped__()
    file.rename(file.with_name("other.py"))
    assert len({first, second, programs._source.__wrapped__()}) == 3
    assert time.time() - 3600 * 24 < programs._process_began() < time.time()


def test_what_a_plugin_adds_is_not_known_so_nothing_is_kept(kept):
    registry = plugins.Registry("part", {"ours": ConstantVelocity})
    assert newly()(2.0, *ARGUMENTS)
    registry["again"] = ConstantVelocity
    newly()(2.0, *ARGUMENTS)
    assert len(list(kept.iterdir())) == 3, "another table is another key"

    @registry.register("theirs")
    @dataclasses.dataclass(frozen=True)
    class Theirs(ConstantVelocity):
        pass

    for _ in range(2):
        function, traces = counted(scaled)
        newly(function)(3.0, *ARGUMENTS)
        assert len(traces) == 1
    assert len(list(kept.iterdir())) == 3


def test_only_what_another_process_would_name_so_is_spelled():
    ours = [NoiseSpec(3), NoiseSpec(3, True), ConstantVelocity, ("a", 1), {"a": 1.5}]
    ours += [
        functools.partial(spelled, 2),
        functools.partial(spelled, 3),
        None,
        True,
        1,
    ]
    texts = [spelled(value) for value in ours]
    assert len(set(texts)) == len(texts)
    assert spelled(NoiseSpec(3)) == texts[0]
    for value in (lambda: 0, counted, np.zeros(3), object(), jnp.tanh, {1: print}):
        with pytest.raises(Unnamed):
            spelled(value)


def test_a_package_of_somebody_else_with_a_name_like_ours_has_no_name(
    tmp_path, monkeypatch
):
    (tmp_path / "neurosym_else.py").write_text("def function(): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("neurosym_else")
    with pytest.raises(Unnamed):
        spelled(module.function)


def test_a_folder_that_others_own_or_could_write_is_not_trusted(tmp_path):
    ours = tmp_path / "ours"
    assert private_folder(ours)
    assert ours.stat().st_mode & 0o777 == 0o700
    ours.chmod(0o777)
    assert private_folder(ours)
    assert ours.stat().st_mode & 0o022 == 0
    (tmp_path / "link").symlink_to(ours)
    assert not private_folder(tmp_path / "link")
    (tmp_path / "file").touch()
    assert not private_folder(tmp_path / "file")
    if os.getuid() == 0:
        os.chown(ours, 12345, -1)
        assert not private_folder(ours)
        assert (ours.stat().st_uid, ours.stat().st_mode & 0o777) == (12345, 0o755)


@pytest.mark.slow
def test_a_warm_process_traces_nothing_and_a_plugin_is_never_served_from_the_store(
    tmp_path,
):
    plugin = tmp_path / "mine.py"
    plugin.write_text(PLUGIN)

    def forecast(*arguments, **environment):
        words = ("-c", FORECAST, SMALL, *arguments)
        cache = {"XDG_CACHE_HOME": str(tmp_path), "JAX_COMPILATION_CACHE_DIR": ""}
        bits, *traced = run_python(*words, **cache, **environment).stdout.split()
        return bits, traced

    cold, warm = forecast(), forecast()
    assert warm[0] == cold[0]
    assert "forecast_scene" in cold[1]
    assert not warm[1]
    files = set(tmp_path.rglob("programs/*.program"))
    assert files
    beside = forecast(plugin)
    assert beside[0] == cold[0]
    assert "forecast_scene" in beside[1]
    assert set(tmp_path.rglob("programs/*.program")) == files


@pytest.mark.slow
def test_a_warm_evaluation_of_a_text_file_imports_no_library_of_networks(tmp_path):
    frame, person = np.divmod(np.arange(120), 3)
    x, y = 0.5 * frame - person, 2.0 * person + 0.1 * np.sin(frame)
    rows = np.column_stack([10 * frame, 1 + person, x, y])
    table = {"fmt": ("%d", "%d", "%.4f", "%.4f"), "delimiter": ",", "comments": ""}
    np.savetxt(tmp_path / "walk.csv", rows, header="frame,id,x,y", **table)
    words = ["-X", "importtime", "-m", "neurosym_jax", "evaluate", "--no-figures"]
    words += ["--data", tmp_path / "walk.csv", "--baselines", "anchor_table"]
    words += ["--json", tmp_path / "rows.json"]

    def evaluate():
        done = run_python(*words, XDG_CACHE_HOME=str(tmp_path))
        lines = done.stderr.splitlines()
        times = [line for line in lines if line.startswith("import time:")]
        return done.stdout, {line.split("|")[-1].strip() for line in times}

    cold, warm = evaluate(), evaluate()
    heavy = {"flax", "optax", "orbax", "matplotlib"}
    heavy |= {"scipy.special", "scipy.spatial", "scipy.stats", "torch"}
    assert "anchor table" in warm[0]
    assert "flax" in cold[1], "the first run has to trace the network"
    assert "jax" in warm[1]
    assert warm[1] & heavy == set()


def test_getattr_gives_members_of_enumerations_and_nothing_else():
    """Python before 3.11.4 pickles them so, and no kept program was read there."""
    member = programs._Data(io.BytesIO(b"")).find_class("builtins", "getattr")
    kind = jax.sharding.AxisType
    assert member(kind, "Auto") is kind.Auto
    with pytest.raises(pickle.UnpicklingError, match="getattr"):
        member(np, "load")
    with pytest.raises(KeyError):
        member(kind, "__class__")
