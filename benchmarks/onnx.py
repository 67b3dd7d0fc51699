"""ONNX Runtime beside JAX: size of a file, seconds until the first forecast, and of a forecast.

Both run the same program of a shipped model for 10 and 200 people, each in a process of
its own. The first forecast takes `load_model` and compiling in JAX, and making a
session in ONNX Runtime, which needs neither JAX nor this package.
"""

import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.timing import OURS, alternate, row, rows

MODELS = ("recommended", "neurosym_zara1_8", "sgan_zara1_8")
PEOPLE = (10, 200)
ONNX = "ONNX Runtime"


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    import jax
    import onnxruntime

    from neurosym_jax.interop.export import export_model, export_onnx, program_of
    from neurosym_jax.models.disk import load_model

    table = []
    for name in MODELS:
        model = load_model(name)
        spec, onnx_program = model.forecaster.noise, export_onnx(model)
        table.append(row(f"{name}, file", ONNX, [len(onnx_program) / 1e6], "MB"))
        table.append(
            row(f"{name}, file", "StableHLO", [len(export_model(model)) / 1e6], "MB")
        )
        rng = np.random.default_rng(0)
        for people in PEOPLE:
            steps = rng.normal(0.3, 0.1, (people, model.config.obs_len, 2)).cumsum(
                axis=1
            )
            observed = (rng.uniform(-10, 10, (people, 1, 2)) + steps).astype(np.float32)
            noise = rng.normal(size=(20, spec.dim)).astype(np.float32)
            arguments = (observed, noise) if spec.dim else (observed,)
            values = dict(zip(("observed", "noise"), arguments))
            begin = time.perf_counter()
            session = onnxruntime.InferenceSession(onnx_program)
            forecasts = session.run(None, values)[0]
            loaded = time.perf_counter()
            compiled = jax.jit(program_of(load_model(name)))
            expected = np.asarray(compiled(*arguments)[0])
            seconds = {ONNX: loaded - begin, OURS: time.perf_counter() - loaded}
            if np.abs(forecasts - expected).max() > 3e-5:
                raise AssertionError(
                    f"{name}: {np.abs(forecasts - expected).max()} m apart"
                )
            case = f"{name}, {people} people"
            if people == PEOPLE[0]:
                table += [
                    row(f"{name}, first forecast", who, [s])
                    for who, s in seconds.items()
                ]
            contestants = {
                OURS: functools.partial(_jax_program, name, arguments),
                ONNX: functools.partial(_onnx_session, onnx_program, values),
            }
            table += rows(case, alternate(contestants, 4 * options.repeats, warm=2))
    return {"title": "ONNX Runtime beside JAX", "rows": table}


def _jax_program(name: str, arguments: tuple[np.ndarray, ...]) -> Callable[[], None]:
    import jax

    from neurosym_jax.interop.export import program_of
    from neurosym_jax.models.disk import load_model

    compiled = jax.jit(program_of(load_model(name)))

    def run() -> None:
        jax.block_until_ready(compiled(*arguments))

    return run


def _onnx_session(
    onnx_program: bytes, values: dict[str, np.ndarray]
) -> Callable[[], None]:
    import onnxruntime

    session = onnxruntime.InferenceSession(onnx_program)

    def run() -> None:
        session.run(None, values)

    return run
