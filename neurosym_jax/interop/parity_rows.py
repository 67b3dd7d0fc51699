"""The rows of a comparison with torch, their table and the verdict."""

import dataclasses
import math
from typing import Any

import numpy as np

from neurosym_jax.evaluation.markdown import aligned_table
from neurosym_jax.interop.case import Compared, GeneratorCase
from neurosym_jax.interop.layers import compared_layers, likely_reason

__all__ = ["TOLERANCE", "Parity", "ParityRow", "rows_of"]

TOLERANCE = 1e-5
"""Largest absolute difference that passes, in the output's own unit."""


@dataclasses.dataclass(frozen=True)
class ParityRow:
    """One output of one case; of a case that was skipped, only `case` and `skipped` are known."""

    case: str
    output: str | None = None
    shape: tuple[int, ...] | None = None
    max_abs: float | None = None
    """Largest absolute difference, in the output's own unit; NaN where one is not finite. A layer
    passes with the tolerance times torch's largest magnitude, if that is above 1."""
    max_rel: float | None = None
    """`max_abs` over torch's largest magnitude; single elements may be next to nothing."""
    ok: bool | None = None
    skipped: str | None = None
    """Why nothing was compared."""
    reason: str | None = None
    """Why it differs, of the first layer of a case that does."""


@dataclasses.dataclass(frozen=True)
class Parity:
    """All rows of a comparison; as text a table with a verdict."""

    rows: tuple[ParityRow, ...]
    tolerance: float = TOLERANCE
    assumed: tuple[str, ...] = ()
    """What a checkpoint does not say and was taken to be so."""

    @property
    def ok(self) -> bool:
        """Whether something was compared, and all of it is within the tolerance."""
        compared = [row.ok for row in self.rows if row.skipped is None]
        return bool(compared) and all(compared)

    def __str__(self) -> str:
        """An aligned table, what was assumed, and the verdict."""
        table: list[tuple[str, ...]] = [("case", "output", "shape", "max abs", "max rel", "")]
        for row in self.rows:
            if row.skipped is not None:
                table.append((row.case, "-", "-", "-", "-", f"skipped: {row.skipped}"))
                continue
            shape = "x".join(map(str, row.shape or ())) or "scalar"
            numbers = (f"{row.max_abs:.1e}", f"{row.max_rel:.1e}")
            verdict = "ok" if row.ok else "MISS"
            table.append((row.case, row.output or "-", shape, *numbers, verdict))
        compared = [row for row in self.rows if row.skipped is None]
        within = sum(bool(row.ok) for row in compared)
        verdict = f"{within} of {len(compared)} outputs within {self.tolerance:g}"
        verdict = verdict if compared else "nothing was compared"
        lines = [aligned_table(table), ""]
        if self.assumed:
            lines += [f"assumed, for the checkpoint does not say: {'; '.join(self.assumed)}"]
        for row in self.rows:
            if row.reason is not None:
                lines += [f"first difference of {row.case}: {row.output}: {row.reason}"]
        return "\n".join([*lines, f"{verdict}; {len(self.rows) - len(compared)} cases skipped"])

    def to_json(self) -> dict[str, Any]:
        """Plain values; a difference that is not finite is None."""
        rows = [dataclasses.asdict(row) for row in self.rows]
        for row in rows:
            for name in ("max_abs", "max_rel"):
                if row[name] is not None and not math.isfinite(row[name]):
                    row[name] = None
        head = {"format": 1, "tolerance": self.tolerance, "assumed": list(self.assumed)}
        return head | {"ok": self.ok, "rows": rows}


def rows_of(
    name: str, tolerance: float, compared: Compared, case: GeneratorCase | None
) -> list[ParityRow]:
    """The rows of a case, its layers first; the first that misses has the reason."""
    layers = {} if case is None else compared_layers(case)
    rows, missed = [], False
    for output, (ours, theirs) in (layers | compared).items():
        # A layer's numbers may be of any size, and so is their rounding.
        scale = max(1.0, float(np.abs(theirs).max())) if output in layers else 1.0
        row = _row(name, tolerance * scale, output, np.asarray(ours), np.asarray(theirs))
        if case is not None and not row.ok and not missed:
            missed = True
            row = dataclasses.replace(row, reason=likely_reason(case, output, ours, theirs))
        rows.append(row)
    return rows


def _row(
    case: str, tolerance: float, output: str, ours: np.ndarray, theirs: np.ndarray
) -> ParityRow:
    max_abs = math.nan
    if ours.shape == theirs.shape:
        max_abs = float(np.abs(ours.astype(np.float64) - theirs).max())
    scale = float(np.abs(theirs).max())
    # Against an output that is all zeros, any difference is infinitely large, and none is none.
    relative = max_abs / scale if scale else (math.inf if max_abs else 0.0)
    return ParityRow(case, output, theirs.shape, max_abs, relative, max_abs <= tolerance)
