"""Parity: how far our outputs are from torch's, of stored cases or of a module that runs now.

A golden directory holds `manifest.json` with a row for each case, and an `.npz` for each case with
torch's weights, inputs and outputs (`docs/parity.md` says which, and how to make them).
"""

import json
import math
import subprocess
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.interop import torch_side
from neurosym_jax.interop.arguments import refuse_unknown
from neurosym_jax.interop.case import GeneratorCase
from neurosym_jax.interop.cases import CASES, compared_forecasts
from neurosym_jax.interop.parity_rows import TOLERANCE, Parity, ParityRow, rows_of
from neurosym_jax.interop.train_step import RECIPE

__all__ = ["compare", "run_parity", "run_torch"]

FIELDS = {"file", "model", "variant", "alpha", "layers", *RECIPE.values()}
"""Of a manifest row, besides the arguments of the networks."""
SCRIPT = Path(torch_side.__file__)


def run_parity(
    directory: Path,
    tolerance: float = TOLERANCE,
    *,
    ignore: Collection[str] = (),
    assumed: tuple[str, ...] = (),
) -> Parity:
    """Each output of each case of `directory`, in the manifest's order.

    Args:
        directory: of the cases.
        tolerance: largest absolute difference that passes.
        ignore: fields of rows that nobody knows and that change no network.
        assumed: for the verdict.

    Raises:
        InputError: naming the file, and the field or the array that is missing or wrong.
    """
    _check(tolerance)
    rows = []
    manifest = _read_manifest(directory)
    for row in manifest:
        if not (directory / row["file"]).is_file():
            raise InputError(f"{directory / row['file']}: is in the manifest and does not exist")
    for row in manifest:
        path = directory / row["file"]
        # The name of a row's kind of case: its model's, else its file's.
        kind = str(row.get("variant", row.get("model", path.stem)))
        if kind not in CASES:
            reason = f"this version compares no {kind!r} cases"
            rows.append(ParityRow(row["file"], skipped=reason))
            continue
        try:
            refuse_unknown(row, set(ignore) & row.keys(), FIELDS)
            arrays = _read_arrays(path)
            compared = CASES[kind](row, arrays)
            case = GeneratorCase(row, arrays) if "layers" in row else None
            rows += rows_of(row["file"], tolerance, compared, case)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    return Parity(tuple(rows), tolerance, assumed)


def compare(
    torch_module: Any,
    model: Model,
    scenes: Sequence[ArrayLike] | None = None,
    *,
    tolerance: float = TOLERANCE,
    seed: int = 0,
) -> Parity:
    """Compare a torch generator with SGAN's interface and `model`, layer by layer.

    Args:
        torch_module: of SGAN's code or a change of it, with its weights. It is copied, and runs on
            the CPU after `eval()`; the noise is given to it as `user_noise`.
        model: one of a torch checkpoint.
        scenes: [N, obs_len, 2] metres each, N may differ; default: people who walk at random.
        tolerance: largest absolute difference that passes.
        seed: of the noise and the default scenes.

    Raises:
        InputError: for another model, scenes of other lengths, or a module that fails.
    """
    import torch  # pyright: ignore[reportMissingImports]

    _check(tolerance)
    config = model.config
    if model.kind != "generator" or config.symbolic or "alpha_rows" in config.pooling.inputs:
        raise InputError(f"{model.name}: only SGAN's networks run in torch from here")
    row = {name: getattr(config, name) for name in ("obs_len", "pred_len", "noise_mix_type")}
    row["noise_dim"] = config.noise_dim
    given = torch_side.random_scenes(row, np.random.RandomState(seed))
    if scenes is not None:
        given = _given_scenes([np.asarray(scene, np.float64) for scene in scenes], row, seed)
    try:
        arrays, layers = torch_side.forecast(torch, torch_module, given)
    except Exception as error:
        raise InputError(f"the torch module fails: {type(error).__name__}: {error}") from None
    case = GeneratorCase({"layers": layers}, arrays, of=(config, model.params["params"]))
    name = type(torch_module).__name__
    rows = rows_of(name, tolerance, compared_forecasts(case), case)
    return Parity(tuple(rows), tolerance, model.assumed)


def run_torch(
    module: str, checkpoints: Sequence[Path], out: Path, *, python: str, seed: int
) -> None:
    """Let the module `FILE.py:CLASS` forecast with each checkpoint, and store cases in `out`.

    Raises:
        InputError: for a file that is not there, and whatever the module says when it fails.
    """
    file, colon, name = module.rpartition(":")
    if not colon or not name.isidentifier() or not Path(file).is_file():
        raise InputError(f"--torch-module {module}: must be FILE.py:CLASS")
    given = {
        "module": f"{Path(file).resolve()}:{name}",
        "checkpoints": [str(path.resolve()) for path in checkpoints],
        "out": str(out.resolve()),
        "seed": seed,
    }
    try:
        # As text: the folder of a file that is run comes first where Python looks for modules.
        done = subprocess.run(
            [python, "-c", SCRIPT.read_text(encoding="utf-8"), json.dumps(given)],
            cwd=Path(file).resolve().parent,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
    except OSError as error:
        raise InputError(f"--python {python}: {error.strerror}") from None
    if done.returncode:
        # A traceback is indented; an error's own words may take several lines after it.
        said = done.stderr.rpartition("\n  ")[2].splitlines()[1:] or [done.stderr]
        said = " ".join(" ".join(said).split())[:400] or "no reason given"
        raise InputError(f"--python {python}: {module} failed: {said}")


def _check(tolerance: float) -> None:
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise InputError(f"tolerance must be a number of at least 0, not {tolerance}")


def _given_scenes(
    scenes: Sequence[np.ndarray], row: Mapping[str, Any], seed: int
) -> dict[str, np.ndarray]:
    """The arrays of `torch_side.random_scenes`, of these scenes."""
    steps = row["obs_len"]
    for number, scene in enumerate(scenes):
        if scene.ndim != 3 or scene.shape[1:] != (steps, 2) or not len(scene):
            raise InputError(f"scene {number} is {list(scene.shape)}, not [agents, {steps}, 2]")
    if not scenes:
        raise InputError("scenes must be at least one")
    # The future is not looked at.
    traj = np.pad(np.concatenate(scenes), [(0, 0), (0, row["pred_len"]), (0, 0)], "edge")
    ends = np.cumsum([len(scene) for scene in scenes])
    rows = len(scenes) if row["noise_mix_type"] == "global" else len(traj)
    noise = np.random.default_rng(seed).normal(size=(rows, row["noise_dim"])).astype(np.float32)
    return {
        "traj": traj,
        "traj_rel": np.diff(traj, axis=1, prepend=traj[:, :1]),
        "scene_start_end": np.stack([np.append(0, ends[:-1]), ends], axis=1),
        "noise": noise,
    }


def _read_manifest(directory: Path) -> list[dict[str, Any]]:
    path = directory / "manifest.json"
    if not directory.is_dir():
        raise InputError(f"{directory}: no such directory")
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error})") from None
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: must be a list of at least one case")
    for index, row in enumerate(rows):
        file = row.get("file") if isinstance(row, dict) else None
        if not isinstance(file, str) or not file or Path(file).name != file:
            raise InputError(f"{path}: row {index} needs 'file', a name in the same directory")
    return rows


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})") from None
    except Exception as error:
        # A damaged archive fails in whichever way the damage dictates, and a .npy has no `files`.
        raise InputError(f"not an .npz of plain arrays ({' '.join(str(error).split())})") from None
