"""Parity: how far our outputs are from those of a stored torch run. Needs no torch.

A golden directory holds `manifest.json` with a row for each case, and an `.npz` for each case with
torch's weights, inputs and outputs (`docs/parity.md` says which, and how to make them).
"""

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.markdown import aligned_table
from neurosym_jax.interop.parity_case import Arrays, Compared
from neurosym_jax.interop.parity_networks import neurosym, sgan
from neurosym_jax.interop.parity_symbols import qtc
from neurosym_jax.interop.parity_training import train_step

__all__ = ["CASES", "TOLERANCE", "ParityRow", "format_parity", "parity_json", "run_parity"]

TOLERANCE = 1e-5
"""Largest absolute difference that passes, in the output's own unit."""

CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    "sgan": sgan,
    "neurosym_ros": neurosym,
    "neurosym_ijcnn": neurosym,
    "qtc": qtc,
    "train_step": train_step,
}
"""By kind of case the function that compares it: (manifest row, arrays) to {output: (ours,
theirs)}."""


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
    compared = [row for row in rows if row.skipped is None]
    misses = sum(not row.ok for row in compared)
    skipped = len(rows) - len(compared)
    if not compared:
        summary = "nothing was compared"
    else:
        within = len(compared) - misses
        summary = f"{within} of {len(compared)} outputs within {compared[0].tolerance:g}"
    return f"{aligned_table(table)}\n\n{summary}; {skipped} cases skipped"


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
