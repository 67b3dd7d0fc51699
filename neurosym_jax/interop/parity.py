"""Parity: how far our outputs are from torch's, of stored cases or of a module that runs now.

A golden directory holds `manifest.json` with a row for each case, and an `.npz` for
each case with torch's weights, inputs and outputs (`tests/golden/README.md` says which,
and how to make them).
"""

import dataclasses
import functools
import json
import math
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, refuse
from neurosym_jax.errors import InputError, brief, option
from neurosym_jax.evaluation.tables import aligned_table
from neurosym_jax.interop import torch_side
from neurosym_jax.interop.cases import (
    CASES,
    Case,
    Compared,
    forecasts,
    make_case,
    read_case,
)
from neurosym_jax.interop.checkpoint import Contents, released_config
from neurosym_jax.models import Generator
from neurosym_jax.models.forecast import Model, refuse_other_length
from neurosym_jax.models.sgan.network import LSTM, LSTMNetwork
from neurosym_jax.models.sgan.torch_names import torch_names
from neurosym_jax.runtime.foreign import read_arrays, read_json, reading
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import checked_positions, model_dtype

__all__ = ["TOLERANCE", "Parity", "ParityRow", "compare", "row_fields", "run_parity"]
__all__ += ["run_torch"]

TOLERANCE = 1e-5
"""Largest absolute difference that passes, in the output's own unit."""
LONGEST = 100
"""Values in an argument of a checkpoint's that a torch module is given."""
NO_RELU = {"Linear", "ReLU", "Dropout", "Sequential"}
"""Classes in a perceptron of SGAN's that are no other activation."""


@dataclasses.dataclass(frozen=True)
class ParityRow:
    """One output of one case."""

    case: str
    output: str
    shape: tuple[int, ...]
    max_abs: float
    """Largest absolute difference, in the output's own unit; NaN where one is not finite. A layer
    passes with the tolerance times torch's largest magnitude, if that is above 1."""
    max_rel: float
    """`max_abs` over torch's largest magnitude; single elements may be next to nothing."""
    ok: bool
    reason: str = ""
    """Why the first layer of a case that differs does."""


@dataclasses.dataclass(frozen=True)
class Parity:
    """All rows of a comparison; as text a table with a verdict."""

    rows: tuple[ParityRow, ...]
    tolerance: float = TOLERANCE
    assumed: tuple[str, ...] = ()
    """What a checkpoint does not say and was taken to be so, in words."""

    @property
    def ok(self) -> bool:
        """Whether something was compared, and all of it is within the tolerance."""
        return bool(self.rows) and all(row.ok for row in self.rows)

    def to_json(self) -> dict[str, Any]:
        """The verdict and all rows; differences that are not finite are null."""
        return {
            "ok": self.ok,
            "tolerance": self.tolerance,
            "assumed": list(self.assumed),
            "rows": [row_fields(row) for row in self.rows],
        }

    def __str__(self) -> str:
        """An aligned table and the verdict."""
        table = [("case", "output", "shape", "max abs", "max rel", "")]
        for row in self.rows:
            shape = "x".join(map(str, row.shape)) or "scalar"
            verdict = "ok" if row.ok else "MISS"
            numbers = f"{row.max_abs:.1e}", f"{row.max_rel:.1e}"
            table.append((row.case, row.output, shape, *numbers, verdict))
        differ = (row for row in self.rows if row.reason)
        lines = [
            f"first difference of {row.case}: {row.output}: {row.reason}"
            for row in differ
        ]
        if self.assumed:
            lines.append(
                f"assumed, for the checkpoint does not say: {'; '.join(self.assumed)}"
            )
        within = f"{sum(row.ok for row in self.rows)} of {len(self.rows)} outputs"
        return "\n".join(
            [aligned_table(table), "", *lines, f"{within} within {self.tolerance:g}"]
        )


def row_fields(row: Any) -> dict[str, Any]:
    """The fields of a dataclass for JSON, with null for a number that is not finite."""
    fields = dataclasses.asdict(row)
    for name, value in fields.items():
        if isinstance(value, float) and not math.isfinite(value):
            fields[name] = None
    return fields


def run_parity(directory: Path, tolerance: float = TOLERANCE) -> Parity:
    """Each output of each case of `directory`, in the manifest's order.

    Raises:
        InputError: naming the file, and the field or the array that is missing or
            wrong.
    """
    refuse(NotNegative, {"tolerance": tolerance})
    path = directory / "manifest.json"
    rows = []
    with reading(path, "a list of cases"):
        cases = []
        for row in read_json(path):
            if "file" not in row:
                raise InputError("'file' is missing")
            cases.append((directory / row["file"], row))
    for path, row in cases:
        with reading(path, "a case"):
            rows += _rows_of_case(path, row, tolerance)
    return Parity(tuple(rows), tolerance)


def _rows_of_case(path: Path, row: Mapping[str, Any], tolerance: float) -> list[Any]:
    """The outputs of a stored case, compared."""
    # The name of a row's kind of case: its model's, else its file's.
    kind = row.get("model", path.stem)
    classes = row.get("layers", {})
    if kind not in CASES:
        raise InputError(f"{brief(kind)} is none of the cases {', '.join(CASES)}")
    arrays = read_arrays(path, "a case")
    try:
        layers = {}
        if classes:
            layers = _compared_layers(read_case(row, arrays), classes)
        return _compare(path.name, tolerance, CASES[kind](row, arrays), layers, classes)
    except KeyError as error:
        raise InputError(f"{error} is missing") from None


def run_torch(
    module: str,
    contents: Contents,
    out: Path,
    *,
    title: str,
    python: str,
    seed: int,
    training: Mapping[str, Any] | None = None,
) -> None:
    """Let the module `FILE.py:CLASS` forecast with a checkpoint, and store the case in `out`.

    Args:
        module: the file and the class of the user's network.
        contents: what our reader read of the checkpoint. Torch gets its `args` and
            `g_state`, and never opens the file.
        out: folder of the case.
        title: name of the case.
        python: the interpreter that has torch.
        seed: of the scenes and the noise; of a training, of fresh weights.
        training: settings of a training and its arrays, which runs in place of a
            forecast, see `training_parity`.

    Raises:
        InputError: for a file that is not there, and whatever the module says when it
            fails.
    """
    file, _, name = module.rpartition(":")
    if not name.isidentifier() or not Path(file).is_file():
        raise InputError(f"{option('torch_module', module)}: must be FILE.py:CLASS")
    # As text: the folder of a file that is run comes first where Python looks for
    # modules.
    script = Path(torch_side.__file__).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as inputs:
        hand_over(Path(inputs), title, contents, training)
        words = [Path(file).resolve(), inputs, out.resolve(), name, str(seed)]
        try:
            done = subprocess.run(
                [python, "-c", script, *words], capture_output=True, text=True
            )
        except OSError as error:
            raise InputError(f"{option('python', python)}: {error.strerror}") from None
    if done.returncode:
        messages = done.stderr.strip().splitlines() or ["no reason given"]
        raise InputError(f"{python}: {module} failed: {messages[-1][:400]}")


def hand_over(
    folder: Path,
    title: str,
    contents: Contents,
    training: Mapping[str, Any] | None = None,
) -> None:
    """Write arguments and weights of a checkpoint for `torch_side`, as JSON and plain arrays.

    Arguments that are no plain values, or lists or tuples of some, are left out: no
    constructor of SGAN's takes any. Of a `training`, arrays go into a file of their own.
    """
    arguments, arrays = {}, {}
    for name, value in contents["args"].items():
        if _is_plain(value):
            arguments[str(name)] = value
    for state in ("g_state", "d_state"):
        if isinstance(contents.get(state), Mapping):
            for name, tensor in contents[state].items():
                arrays[f"{state}/{name}"] = np.asarray(tensor)
    np.savez(folder / "state.npz", **arrays)
    tuples = [name for name in arguments if isinstance(arguments[name], tuple)]
    description: dict[str, Any] = {"title": title, "arguments": arguments}
    description["tuples"] = tuples
    if training is not None:
        description["training"] = training["settings"]
        np.savez(folder / torch_side.TRAINING, **training["arrays"])
    (folder / "contents.json").write_text(json.dumps(description), encoding="ascii")


def _is_plain(value: Any) -> bool:
    """Whether an argument is a number, a text or nothing, or a short list or tuple of these."""
    parts = value if isinstance(value, list | tuple) else [value]
    return len(parts) <= LONGEST and all(
        part is None or isinstance(part, int | float | str) for part in parts
    )


def compare(
    torch_module: Any,
    model: Model,
    scenes: Sequence[ArrayLike] | None = None,
    *,
    seed: int = 0,
    tolerance: float = TOLERANCE,
) -> Parity:
    """Compare a torch generator that is here in Python with `model`, layer by layer.

    Args:
        torch_module: SGAN's `TrajectoryGenerator`, changed or not. A copy of it runs on
            the CPU.
        model: the same network, see `load_model` and `model_from_torch`.
        scenes: people observed, [N, obs_len, 2] metres each; default: people who walk
            at random.
        seed: of the noise and of these people.
        tolerance: largest absolute difference that passes.

    Raises:
        InputError: for a model that SGAN's code does not have, and unusable scenes.
    """
    import torch  # pyright: ignore[reportMissingImports]

    config = released_config(model)
    walks = torch_side.random_walks(config.obs_len, seed) if scenes is None else scenes
    walks = [checked_positions(f"scenes[{i}]", walk) for i, walk in enumerate(walks)]
    for i, walk in enumerate(walks):
        refuse_other_length(model, walk, f"scenes[{i}]")
    inputs = torch_side.inputs(walks, vars(config), seed, torch_module)
    arrays, classes = torch_side.forecast(torch, torch_module, inputs)
    case = make_case(config, model.params["params"], arrays)
    name = type(torch_module).__name__
    rows = _compare(
        name, tolerance, forecasts(case), _compared_layers(case, classes), classes
    )
    return Parity(tuple(rows), tolerance, model.assumed)


def _compared_layers(case: Case, names: Mapping[str, str]) -> Compared:
    """(ours, theirs) by row, for torch's submodules `names` in the order in which they returned.

    A layer `alone` is ours on the input that torch's was given; any other row is our
    network's own value at that place, from the scenes on. A layer that torch never
    called is compared with NaN.
    """
    arrays = case.arrays
    stages = case.stages()
    layers = _layers(case)
    compared: Compared = {}
    if "in/encoder.spatial_embedding" in arrays:
        moves = arrays["traj_rel"][:, : case.config.obs_len]
        moves = moves.swapaxes(0, 1).reshape(-1, 2)
        compared["obs_traj_rel"] = moves, arrays["in/encoder.spatial_embedding"]
    for name in names:
        if name == "decoder.decoder" and f"h0/{name}" in arrays:
            start = np.concatenate([stages["mlp_decoder_context"], case.noise], axis=-1)
            compared["decoder, first state"] = start, arrays[f"h0/{name}"][0]
        reference = arrays[f"out/{name}"]
        if name in layers:
            compared[f"{name} (alone)"] = _alone(arrays, name, layers[name]), reference
        if name in stages:
            compared[name] = stages[name], reference
    for name in layers.keys() - names.keys():
        compared[f"{name} (alone)"] = np.zeros(1), np.full(1, np.nan)
    return compared


def _layers(case: Case) -> dict[str, Any]:
    """Our layers and perceptrons, by torch's names."""
    network = Generator(case.config).bind({"params": case.params})
    layers = {}
    for name, (path, _) in torch_names(case.config).items():
        path = re.sub(r"/layer_\d", "", path).replace("lstm", "recurrent")
        *parts, _ = path.split("/")
        layer = re.sub(r"(\.\d)?\.\w+$", "", name)
        layers[layer] = functools.reduce(getattr, parts, network)
    return layers


@full_precision
def _alone(arrays: Mapping[str, np.ndarray], name: str, layer: Any) -> np.ndarray:
    """Our layer's output for the inputs that torch's was given."""
    inputs = arrays[f"in/{name}"].astype(model_dtype())
    if not isinstance(layer, LSTMNetwork):
        return np.asarray(layer(inputs))
    zeros = np.zeros((1, inputs.shape[1], layer.features), inputs.dtype)
    state = tuple(arrays.get(f"{part}/{name}", zeros)[0] for part in ("h0", "c0"))
    hidden = []
    for step in inputs:
        gates = layer(step) + state[0] @ layer.recurrent_kernel
        state = LSTM().update(gates, state)
        hidden.append(state[0])
    return np.stack(hidden)


def _compare(
    name: str,
    tolerance: float,
    compared: Compared,
    layers: Compared,
    classes: Mapping[str, str],
) -> list[ParityRow]:
    """The rows of a case `name`, its layers first; the first that misses has the reason."""
    rows: list[ParityRow] = []
    for output, (values, reference) in (layers | compared).items():
        values = np.asarray(values)
        reference = np.asarray(reference)
        scale = float(np.abs(reference).max())
        max_abs = math.nan
        if values.shape == reference.shape:
            difference = values.astype(np.float64) - reference
            max_abs = float(np.abs(difference).max())
        # Against an output that is all zeros, any difference is infinitely large, and
        # none is none.
        max_rel = max_abs / scale if scale else (math.inf if max_abs else 0.0)
        # A layer's numbers may be of any size, and so is their rounding.
        ok = max_abs <= tolerance * (max(1.0, scale) if output in layers else 1.0)
        first = layers and not ok and all(row.ok for row in rows)
        reason = _likely_reason(output, values, reference, classes) if first else ""
        rows.append(
            ParityRow(name, output, reference.shape, max_abs, max_rel, ok, reason)
        )
    return rows


def _likely_reason(
    output: str, values: np.ndarray, reference: np.ndarray, classes: Mapping[str, str]
) -> str:
    """Why the first row that differs does."""
    if np.isnan(reference).all():
        return "the checkpoint has it and the module never calls it"
    if reference.shape != values.shape:
        return f"its shape is {list(reference.shape)}, ours {list(values.shape)}"
    if output.endswith("(alone)"):
        within = output.removesuffix(" (alone)") + "."
        kinds = [kind for name, kind in classes.items() if name.startswith(within)]
        others = [kind for kind in kinds if kind not in NO_RELU]
        if others:
            return f"activation {others[0]}, ours is ReLU"
        if kinds and np.abs(np.maximum(reference, 0) - values).max() < TOLERANCE:
            return "no ReLU after its last layer, ours has one"
        return "it computes something else with the same weights"
    for decimals in range(1, 5):
        rest = np.abs(reference - np.round(reference, decimals)).max()
        if rest < 1e-7 < np.abs(reference).max():
            return f"it is rounded to {decimals} decimals, ours is not"
    return (
        "its layers agree alone, the module's forward puts them together in another way (order of "
        "concatenation, scene boundaries, noise)"
    )
