"""A model as one program for any number of people, which runs without this package.

The program maps `observed [n, obs_len, 2]` and `noise` to `(forecasts [k, n, pred_len,
2], probabilities [k])`, in float32 metres and in the frame of `observed`. `noise` is
[k, dim], or [k, n, dim] for a model with noise for each agent; a model without noise
takes `observed` alone. The parameters are in the program. It is StableHLO, which
`jax.export.deserialize` runs on a CPU or a CUDA device, for a fixed k; or ONNX, for
ONNX Runtime and others, with any k where there is noise.
"""

import contextlib
from collections.abc import Callable, Iterator

import jax
import jax.export
import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError, line_of, optional_module
from neurosym_jax.interop.onnx import to_onnx
from neurosym_jax.models.forecast import Model, forecast_scene, refuse_no_model
from neurosym_jax.scene import make_scene

__all__ = ["export_model", "export_onnx", "program_of"]


def export_model(model: Model, samples: int = 20) -> bytes:
    """The program of `model` with k = `samples` in StableHLO, serialised by `jax.export`.

    Subtract an origin near the people before a call: float32 resolves 4e-6 m at 100 m.

    Raises:
        InputError: for k that the model cannot make, a model that needs more than
            positions, and without flatbuffers.
    """
    optional_module("flatbuffers", "exporting", "export")  # JAX imports it.
    program = program_of(model, samples)
    arguments = _arguments(model, str(model.forecaster.count(samples)))
    with jax.enable_x64(False), _sizes_are_symbols():
        exported = jax.export.export(jax.jit(program), platforms=("cpu", "cuda"))
        return bytes(exported(*arguments.values()).serialize())


@contextlib.contextmanager
def _sizes_are_symbols() -> Iterator[None]:
    """Name the line of a network that takes the number of people for a known number.

    Raises:
        InputError: with the file and the line.
    """
    try:
        yield
    except Exception as error:
        message = str(error)
        if "_DimExpr" not in message and "symbolic dimension" not in message.lower():
            raise
        raise InputError(
            f"{line_of(error)} needs the number of people, which is free "
            "in an exported program: use x.shape[0] for len(x) and functions of "
            "jax.numpy for numpy's"
        ) from error


def export_onnx(model: Model, samples: int = 20, points: bool = False) -> bytes:
    """The program of `model` in ONNX, serialised; see `export_model`.

    `samples` is k for a model without noise; k of other models is free. With `points`,
    anchors also return those of the distribution, [P, n, pred_len, 2], of which scenes
    are drawn; and a model that learned from incomplete histories takes `seen [n,
    obs_len]`, bool, False where `observed` was filled in.

    Raises:
        InputError: as `export_model`, without onnx, for an operation without
            translation, and for `points` of a model without any.
    """
    refuse_no_model(model)
    spec = model.forecaster.noise
    properties = {
        "model": model.forecaster.title,
        "period": f"{model.config.period:g}",
        "noise": spec.distribution if spec.dim else "none",
    }
    program = program_of(model, samples)
    arguments = _arguments(model, "samples")
    outputs = ["forecasts", "probabilities"]
    if points:
        program = _with_points(model, samples)
        outputs.append("points")
        if model.forecaster.shortest < model.config.obs_len:
            steps = arguments["observed"].shape[:2]
            arguments["seen"] = jax.ShapeDtypeStruct(steps, jnp.bool_)
    with _sizes_are_symbols():
        return to_onnx(program, arguments, outputs, properties)


def _with_points(model: Model, samples: int) -> Callable[..., tuple[Array, ...]]:
    """The program of `observed` and `seen` that also returns points."""
    forecaster = model.forecaster
    if not forecaster.calibrated:
        raise InputError(f"points: {model.name} has no distribution of its own")

    program = program_of(model, samples)
    unused = jax.random.key(0)  # Such points are not drawn.

    def with_points(observed: Array, seen: Array | None = None) -> tuple[Array, ...]:
        scene = make_scene(observed, period=model.config.period).replace(seen=seen)
        points = forecaster.points(model.params, scene.bare(), unused)
        origin = jnp.asarray(scene.origin)[None, None, None]
        return (*program(observed, seen=seen), points + origin)

    return with_points


def program_of(model: Model, samples: int = 20) -> Callable[..., tuple[Array, Array]]:
    """The program as a function of `observed`, `noise` where there is any, and `seen`, see `export_onnx`.

    `samples` is k for a model without noise.

    Raises:
        InputError: for k that the model cannot make.
    """
    refuse_no_model(model)
    refuse(Count, {"samples": samples})
    forecaster = model.forecaster
    params = model.params
    count = model.forecaster.count(samples)

    def program(
        observed: Array, noise: Array | None = None, seen: Array | None = None
    ) -> tuple[Array, Array]:
        scene = make_scene(observed, period=model.config.period).replace(seen=seen)
        noise = jnp.zeros((count, 0)) if noise is None else noise
        forecasts, probabilities = forecast_scene(
            forecaster, params, scene.bare(), noise
        )
        if probabilities is None:
            equal = jnp.ones(forecasts.shape[0])
            probabilities = equal / equal.sum()
        return forecasts + jnp.asarray(scene.origin)[None, None, None], probabilities

    return program


def _arguments(model: Model, samples: str) -> dict[str, jax.ShapeDtypeStruct]:
    """The program's arguments by name, of any number of people; `samples` is a number or a name."""
    spec = model.forecaster.noise
    sizes = {"observed": f"people, {model.config.obs_len}, 2"}
    free = ["people"]
    if spec.dim:
        agents = "people, " if spec.per_agent else ""
        sizes["noise"] = f"{samples}, {agents}{spec.dim}"
        if samples.isidentifier():
            free.append(samples)
    scope = jax.export.SymbolicScope([f"{name} >= 1" for name in free])
    arguments = {}
    for name, size in sizes.items():
        shape = jax.export.symbolic_shape(size, scope=scope)
        arguments[name] = jax.ShapeDtypeStruct(shape, jnp.float32)
    return arguments
