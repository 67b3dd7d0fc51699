"""Export a model as StableHLO or ONNX."""

from pathlib import Path

from tyro.conf import Positional

from neurosym_jax.errors import InputError
from neurosym_jax.interop.export import export_model, export_onnx
from neurosym_jax.models.disk import find_model, load_model, spoken_name
from neurosym_jax.runtime.files import new_file

__all__ = ["run"]


def run(
    model: Positional[Path],
    to: Positional[Path],
    samples: int = 20,
    points: bool = False,
) -> None:
    """Export a model as one program for any number of people: ONNX as *.onnx, else StableHLO.

    Args:
        model: A model's folder or name, or a .pt file.
        to: The new file. `jax.export.deserialize` reads StableHLO
            (examples/run_exported.py), ONNX Runtime *.onnx (examples/run_onnx.py).
        samples: Number of forecasts of each call, k; free in ONNX if the model takes
            noise.
        points: Also the points of the distribution, in ONNX: `neurosym ros2 --model
            FILE.onnx` draws from them.

    Raises:
        InputError: as `export_model` and `export_onnx`, and for a file that exists or
            cannot be written.
    """
    if to.exists():
        raise InputError(f"{to}: exists already")
    place = find_model(model)
    loaded = load_model(place)
    if to.suffix == ".onnx":
        program = export_onnx(loaded, samples, points)
    elif points:
        raise InputError(f"{to}: --points are exported to a file *.onnx alone")
    else:
        program = export_model(loaded, samples)
    with new_file(to) as beside:
        beside.write_bytes(program)
    free = to.suffix == ".onnx" and loaded.forecaster.noise.dim
    count = loaded.forecaster.count(samples)
    forecasts = "any number of forecasts" if free else f"{count} forecasts"
    if count == 1 and not free:
        forecasts = "one forecast"
    called = spoken_name(model, place, loaded)
    print(f"{to}: {called}, {forecasts} of any number of people")
