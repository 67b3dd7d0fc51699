"""Strict numerics for every test, cheap compiling, and the folder of real data if there is one.

Most of the time of these tests is XLA's compiling of programs that run once. So
programs are compiled with little optimisation, and kept in a folder that the session's
processes share. Where XLA_FLAGS is set (`XLA_FLAGS= pytest`) it is left alone, and
programs are those of users. `test_optimised.py` runs the tests that hang on rounding in
that way, instead of this one.
"""

import functools
import gc
import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHEAP = {
    "xla_backend_optimization_level": "0",
    "xla_llvm_disable_expensive_passes": "true",
    "xla_cpu_use_fusion_emitters": "false",
    # Workers fill the cores: a program need not be split for them, nor prepared for that.
    "xla_cpu_parallel_codegen_split_count": "1",
    "xla_llvm_force_inline_before_split": "false",
    # XLA's own width, said so that a command that runs in this process changes nothing.
    "xla_cpu_prefer_vector_width": "256",
}

FIRST = ("test_optimised.py", "test_wheel.py")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
QUIET = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *(
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
    ),
)


def accepted(flags: dict[str, str]) -> str:
    """Those of `flags` that XLA accepts in a process of their own: it would end this one."""
    words = [f"--{name}={value}" for name, value in flags.items()]
    while words:
        command = [sys.executable, "-c", "import jax; jax.devices()"]
        environment = {**os.environ, "XLA_FLAGS": " ".join(words)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode == 0:
            break
        # XLA names all that it does not know.
        known = [word for word in words if word not in done.stderr]
        words = known if len(known) < len(words) else []
    return " ".join(words)


if "XLA_FLAGS" not in os.environ:
    os.environ["XLA_FLAGS"] = accepted(CHEAP)
# Names of lines in programs that nobody reads.
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
if (
    "PYTEST_XDIST_WORKER" not in os.environ
):  # A worker takes what the first process has made.
    caches = tempfile.TemporaryDirectory(prefix="neurosym-tests-")
    os.environ["XDG_CACHE_HOME"] = caches.name
    os.environ["NEUROSYM_DATA"] = f"{caches.name}/data"  # Not what was downloaded here.
    # `.ci/mutation/run` names one that its mutants share.
    os.environ.setdefault(
        "JAX_COMPILATION_CACHE_DIR", f"{caches.name}/neurosym_jax/xla"
    )
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

# They import jax, which reads the environment.
import jax  # noqa: E402

from neurosym_jax.models.forecast import Model  # noqa: E402
from neurosym_jax.models.sgan.network import GeneratorConfig  # noqa: E402
from neurosym_jax.simulation import scenarios  # noqa: E402
from tests.networks import random_model  # noqa: E402
from tests.registrations import restored_registrations  # noqa: E402

PROGRAMS_OF_A_CONTEXT = 200
"""A context keeps what its programs have in common, constants too."""


def share_contexts() -> None:
    """Make MLIR's context once for many programs: it takes longer than lowering a small one."""
    mlir = importlib.import_module("jax._src.interpreters.mlir")
    make = getattr(mlir, "make_ir_context", None)
    if make is None:  # A JAX that has another way.
        return
    thread = threading.local()  # Threads compile ahead of use.

    def shared_context():
        calls = getattr(thread, "calls", 0)
        if calls % PROGRAMS_OF_A_CONTEXT == 0:
            thread.context = make()
        thread.calls = calls + 1
        return thread.context

    mlir.make_ir_context = shared_context


if os.environ["XLA_FLAGS"]:  # Else programs are made as those of users are.
    share_contexts()
jax.config.update("jax_debug_nans", True)
# Tracing makes millions of objects that stay: a sixth of the time went into looking for garbage.
gc.set_threshold(200_000, 20, 1_000)
# Commands simulate their default data, here once.
scenarios.simulate = functools.cache(scenarios.simulate)


def pytest_configure(config: pytest.Config) -> None:
    """Give Hypothesis few examples a test, and many where exhaustive tests run."""
    try:
        from hypothesis import settings
    except ImportError:
        return
    complete = "not exhaustive" not in config.option.markexpr
    settings.register_profile(
        "run", max_examples=300 if complete else 15, deadline=None
    )
    settings.load_profile("run")


@pytest.hookimpl(trylast=True)  # After `-m`, which may have left out that file.
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Leave the tests that hang on rounding to `test_optimised.py`, where that is run.

    What takes a minute in one process begins first: another worker would wait for it.
    """
    items.sort(key=lambda item: item.path.name not in FIRST)
    optimised = any(item.path.name == "test_optimised.py" for item in items)
    if optimised and os.environ["XLA_FLAGS"]:
        complete = "not exhaustive" not in config.option.markexpr
        left = [
            item
            for item in items
            if item.get_closest_marker("rounding")
            and (complete or not item.get_closest_marker("slow"))
        ]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]


@pytest.fixture(autouse=True)
def _registrations():
    """What a test registers is gone after it."""
    with restored_registrations():
        yield


@pytest.fixture(scope="module", autouse=True)
def _registrations_of_a_module():
    """What fixtures of a module register is gone after its last test."""
    with restored_registrations():
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of published checkpoints and golden cases; the test skips where it is absent."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("NEUROSYM_SHARED", beside))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder} (set NEUROSYM_SHARED)")
    return folder


@pytest.fixture(scope="session")
def model() -> Callable[..., Model]:
    """`model(pooling, noise_mix_type)`: random weights; it observes 4 steps and forecasts 3."""

    @functools.cache
    def make(pooling: Any = "pool_net", noise_mix_type: Any = "global") -> Model:
        config = GeneratorConfig(
            pooling=pooling
            if pooling in ("none", "social")
            else f"{pooling},hidden_dim=16",
            noise_mix_type=noise_mix_type,
            obs_len=4,
            pred_len=3,
        )
        return random_model(config)

    return make


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium; where there is none, the test says so and is skipped."""
    api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    with api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=found, args=list(QUIET))
        yield chromium
        chromium.close()
