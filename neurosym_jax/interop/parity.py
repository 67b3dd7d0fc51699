"""Output by output, how far our networks are from a torch run that somebody saved.

A golden directory holds a `manifest.json` with one row a case, and one `.npz` a case with torch's
weights, inputs and outputs (see `docs/parity.md` for the form, and for how to make one). It needs
no torch, judges no forecast, and does not read checkpoints, which are `interop.torch`'s.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro
from jax import Array

from neurosym_jax.config import FORMAT, DiscriminatorConfig, GeneratorConfig, from_json
from neurosym_jax.errors import InputError
from neurosym_jax.interop.torch import (
    RENAMED_ARGUMENTS,
    SAME_NAME_ARGUMENTS,
    TORCH_POOLING,
    discriminator_params_from_torch,
    generator_params_from_torch,
)
from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.scene import Scene, make_scene, model_dtype, pad_scene, to_world

__all__ = [
    "CASES",
    "ParityOptions",
    "ParityRow",
    "format_parity",
    "parity",
    "parity_json",
    "run_parity",
]

TOLERANCE = 1e-5
SOCIAL_ONLY = ("neighborhood_size", "grid_size")
FIXED = {"batch_norm": False, "num_layers": 1, "activation": "relu"}
"""What SGAN's constructors also take and our networks have in one form only."""

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[np.ndarray, np.ndarray]]
"""Per output, ours and theirs, of one shape."""


@dataclasses.dataclass(frozen=True)
class ParityRow:
    """One output of one case; of a case that was skipped, only `case` and `skipped` are known."""

    case: str
    tolerance: float
    """Largest absolute difference that is ok."""
    output: str | None = None
    shape: tuple[int, ...] | None = None
    max_abs: float | None = None
    """Largest absolute difference, in the output's own unit; NaN where ours is not finite."""
    max_rel: float | None = None
    """`max_abs` over torch's largest magnitude; single elements may be next to nothing."""
    ok: bool | None = None
    skipped: str | None = None
    """Why nothing was compared."""


@dataclasses.dataclass
class ParityOptions:
    """Compare our networks with a directory of torch cases, output by output."""

    directory: Annotated[Path, tyro.conf.Positional]
    """Holds manifest.json and one .npz for each of its rows."""
    json: Path | None = None
    """Also write the rows here, as JSON."""
    tolerance: float = TOLERANCE
    """Largest absolute difference that passes."""


def parity(options: ParityOptions) -> int:
    """Print the table and return the exit status: 0 where every output compared is within.

    It is 1 for a miss, and where nothing was compared: that proves nothing.

    Raises:
        InputError: as `run_parity`, or when the JSON file cannot be written or is not ours.
    """
    rows = run_parity(options.directory, options.tolerance)
    print(format_parity(rows))
    if options.json is not None:
        from neurosym_jax.evaluation.report import write_json

        write_json(options.json, parity_json(rows))
    compared = [row.ok for row in rows if row.skipped is None]
    return 0 if compared and all(compared) else 1


def run_parity(directory: Path, tolerance: float = TOLERANCE) -> list[ParityRow]:
    """One row for each output of each case of `directory`, in the manifest's order.

    Raises:
        InputError: naming the file, and the field or the array that is missing or wrong.
    """
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise InputError(f"tolerance must be a number of at least 0, not {tolerance}")
    rows = []
    manifest = _read_manifest(directory)
    for row in manifest:
        if not (directory / row["file"]).is_file():
            raise InputError(f"{directory / row['file']}: is in the manifest and does not exist")
    for row in manifest:
        path, kind = directory / row["file"], _kind(row)
        if kind not in CASES:
            reason = f"this version compares no {kind!r} cases"
            rows.append(ParityRow(row["file"], tolerance, skipped=reason))
            continue
        try:
            compared = CASES[kind](row, _read_arrays(path))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        for output, (ours, theirs) in compared.items():
            rows.append(_row(row["file"], tolerance, output, ours, theirs))
    return rows


def format_parity(rows: Sequence[ParityRow]) -> str:
    """An aligned table, and one line that sums it up."""
    head = ("case", "output", "shape", "max abs", "max rel", "")
    table: list[tuple[str, ...]] = [head]
    for row in rows:
        if row.skipped is not None:
            table.append((row.case, "-", "-", "-", "-", f"skipped: {row.skipped}"))
            continue
        shape = "x".join(map(str, row.shape or ())) or "scalar"
        verdict = "ok" if row.ok else "MISS"
        numbers = (f"{row.max_abs:.1e}", f"{row.max_rel:.1e}")
        table.append((row.case, row.output or "-", shape, *numbers, verdict))
    widths = [max(map(len, column)) for column in zip(*table)]
    lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in table]
    compared = [row for row in rows if row.skipped is None]
    misses = sum(not row.ok for row in compared)
    skipped = len(rows) - len(compared)
    if not compared:
        summary = "nothing was compared"
    else:
        within = len(compared) - misses
        summary = f"{within} of {len(compared)} outputs within {compared[0].tolerance:g}"
    return "\n".join([*lines, "", f"{summary}; {skipped} cases skipped"])


def parity_json(rows: Sequence[ParityRow]) -> dict[str, Any]:
    """Format, tolerance and rows as JSON takes them; a difference that is not finite is null."""
    plain = []
    for row in rows:
        fields = dataclasses.asdict(row)
        del fields["tolerance"]
        for name in ("max_abs", "max_rel"):
            if fields[name] is not None and not math.isfinite(fields[name]):
                fields[name] = None
        plain.append(fields)
    return {"format": 1, "tolerance": rows[0].tolerance if rows else None, "rows": plain}


def _row(
    case: str, tolerance: float, output: str, ours: np.ndarray, theirs: np.ndarray
) -> ParityRow:
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    max_abs = float(np.abs(ours - theirs).max())
    scale = float(np.abs(theirs).max())
    # Against an output that is all zeros, any difference is infinitely large, and none is none.
    relative = max_abs / scale if scale else (math.inf if max_abs else 0.0)
    return ParityRow(
        case=case,
        tolerance=tolerance,
        output=output,
        shape=theirs.shape,
        max_abs=max_abs,
        max_rel=relative,
        ok=max_abs <= tolerance,
    )


def _kind(row: Mapping[str, Any]) -> str:
    """The name of a row's kind of case: its model's, else its file's."""
    return str(row.get("variant", row.get("model", Path(row["file"]).stem)))


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


def _array(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """Floating-point array `name`, once it is finite and has `shape`, where None is any size."""
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    if array.dtype.kind != "f":
        raise InputError(f"{name!r} is {array.dtype}, not floating point")
    if not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not finite")
    return array


def _state(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's outputs and, where the row says `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    config = _generator_config(row)
    params = generator_params_from_torch(_state(arrays, "g_state/"), config)
    traj = _array(arrays, "traj", None, config.obs_len + config.pred_len, 2)
    agents, steps, _ = traj.shape
    traj_rel = _array(arrays, "traj_rel", agents, steps, 2)
    bounds = _bounds(arrays, agents)
    observed, observed_rel = traj[:, : config.obs_len], traj_rel[:, : config.obs_len]
    outputs = (agents, config.pred_len, 2)
    pred_rel = _array(arrays, "pred_rel", *outputs)
    pred_abs = _array(arrays, "pred_abs", *outputs)

    scenes = _scenes(observed, observed_rel, bounds)
    noise = _scene_noise(config, arrays, agents, bounds)
    forecast = _forecasts(config, params, _stacked(scenes, bounds), noise)
    ours_rel = [np.asarray(part)[: b - a] for part, (a, b) in zip(forecast, bounds)]
    ours_abs = [
        to_world(np.asarray(scene.observed)[:, -1:] + np.cumsum(part, axis=1), scene)
        for scene, part in zip(scenes, ours_rel)
    ]
    compared = {
        "pred_rel": (np.concatenate(ours_rel), pred_rel),
        "pred_abs": (np.concatenate(ours_abs), pred_abs),
    }
    if "d_type" in row:
        d_config = _discriminator_config(row)
        d_params = discriminator_params_from_torch(_state(arrays, "d_state/"), d_config)
        theirs = _array(arrays, "d_scores_fake", agents)
        fake = np.concatenate([observed, pred_abs], axis=1)
        fake_rel = np.concatenate([observed_rel, pred_rel], axis=1)
        fakes = _stacked(_scenes(fake, fake_rel, bounds), bounds)
        scores = _scores(d_config, d_params, fakes)
        ours = [np.asarray(part)[: b - a] for part, (a, b) in zip(scores, bounds)]
        compared["d_scores_fake"] = (np.concatenate(ours), theirs)
    return compared


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {"sgan": _sgan}
"""Kind of case to what compares it: (manifest row, arrays) to (ours, theirs) by output."""


@functools.partial(jax.jit, static_argnums=0)
def _forecasts(config: GeneratorConfig, params: Any, scenes: Scene, noise: Array) -> Array:
    """[S, N, pred_len, 2] displacements; one scene after another, so memory is that of one."""
    generator = functools.partial(Generator(config).apply, {"params": params})
    return jax.lax.map(lambda given: generator(*given), (scenes, noise))


@functools.partial(jax.jit, static_argnums=0)
def _scores(config: DiscriminatorConfig, params: Any, scenes: Scene) -> Array:
    """[S, N] scores of whole trajectories, held by `scenes` as what was observed."""
    score = functools.partial(Discriminator(config).apply, {"params": params})
    return jax.lax.map(lambda s: score(s.observed, s.displacement, s.valid), scenes)


def _scenes(traj: np.ndarray, traj_rel: np.ndarray, bounds: np.ndarray) -> list[Scene]:
    """The scenes of `traj [A, T, 2]`, moving by what was stored in `traj_rel`."""
    dtype = model_dtype()
    return [
        make_scene(traj[a:b]).replace(displacement=traj_rel[a:b].astype(dtype)) for a, b in bounds
    ]


def _stacked(scenes: Sequence[Scene], bounds: np.ndarray) -> Scene:
    """The scenes padded to one size, so that a case is compiled once, with a leading axis [S]."""
    slots = int((bounds[:, 1] - bounds[:, 0]).max())
    padded = [pad_scene(scene.replace(identity=None, origin=None), slots) for scene in scenes]
    return jax.tree.map(lambda *parts: np.stack(parts), *padded)


def _scene_noise(
    config: GeneratorConfig, arrays: Arrays, agents: int, bounds: np.ndarray
) -> np.ndarray:
    """[S, dim] where noise is global to a scene, else [S, slots, dim]; padding is zero."""
    if config.noise_dim == 0:
        return np.zeros((len(bounds), 0), model_dtype())
    if config.noise_mix_type == "global":
        return _array(arrays, "noise", len(bounds), config.noise_dim)
    noise = _array(arrays, "noise", agents, config.noise_dim)
    slots = int((bounds[:, 1] - bounds[:, 0]).max())
    return np.stack([np.pad(noise[a:b], [(0, slots - (b - a)), (0, 0)]) for a, b in bounds])


def _bounds(arrays: Arrays, agents: int) -> np.ndarray:
    """`scene_start_end [S, 2]`, once it cuts the agents into scenes without gap or overlap."""
    name = "scene_start_end"
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    bounds = arrays[name]
    if bounds.ndim != 2 or bounds.shape[1] != 2 or not len(bounds) or bounds.dtype.kind not in "iu":
        raise InputError(f"{name!r} must be whole numbers [scenes, 2] of at least one scene")
    starts, ends = bounds.astype(np.int64).T
    follows = np.array_equal(starts, [0, *ends[:-1]]) and ends[-1] == agents
    if not follows or (ends <= starts).any():
        raise InputError(f"{name!r} does not cut {agents} agents into scenes one after another")
    return np.stack([starts, ends], axis=1)


def _generator_config(row: Mapping[str, Any]) -> GeneratorConfig:
    pooling = _field(row, "pooling_type")
    named = {theirs: ours for ours, theirs in TORCH_POOLING.items()} | {None: "none"}
    if not isinstance(pooling, str | None) or pooling not in named:
        raise InputError(f"manifest: pooling_type is null, 'pool_net' or 'spool', not {pooling!r}")
    for name, value in FIXED.items():
        if row.get(name, value) != value:
            raise InputError(f"manifest: {name} = {row[name]!r}, and ours is always {value!r}")
    noise_dim = _field(row, "noise_dim")
    if isinstance(noise_dim, list) and len(noise_dim) == 1:
        noise_dim = noise_dim[0]
    fields = {"pooling": named[pooling], "noise_dim": noise_dim}
    for name in (*SAME_NAME_ARGUMENTS, *RENAMED_ARGUMENTS):
        if name not in SOCIAL_ONLY or pooling == "spool":
            fields[name] = _field(row, name)
    return from_json(GeneratorConfig, {"format": FORMAT, **fields}, "manifest")


def _discriminator_config(row: Mapping[str, Any]) -> DiscriminatorConfig:
    fields = {"kind": _field(row, "d_type"), "h_dim": _field(row, "encoder_h_dim_d")}
    fields |= {name: _field(row, name) for name in ("embedding_dim", "mlp_dim")}
    return from_json(DiscriminatorConfig, {"format": FORMAT, **fields}, "manifest")


def _field(row: Mapping[str, Any], name: str) -> Any:
    if name not in row:
        raise InputError(f"manifest: the row has no {name!r}")
    return row[name]
