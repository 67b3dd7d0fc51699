"""Compare our numbers with torch's, output by output."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.evaluation.report import check_report
from neurosym_jax.interop.parity import TOLERANCE, format_parity, parity_json, run_parity
from neurosym_jax.runtime.files import write_json

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare our networks with a directory of torch cases, output by output."""

    directory: Annotated[Path, tyro.conf.Positional]
    """Holds manifest.json and one .npz for each of its rows."""
    json: Path | None = None
    """Also write the rows here, as JSON."""
    tolerance: float = TOLERANCE
    """Largest absolute difference that passes."""


def run(options: Options) -> int:
    """Print the table and return the exit status: 0 where every output compared is within.

    It is 1 for a miss, and where nothing was compared: that proves nothing.

    Raises:
        InputError: as `run_parity`, or when the JSON file cannot be written or is not ours.
    """
    rows = run_parity(options.directory, options.tolerance)
    print(format_parity(rows))
    if options.json is not None:
        check_report(options.json)
        write_json(options.json, parity_json(rows))
    compared = [row.ok for row in rows if row.skipped is None]
    return 0 if compared and all(compared) else 1
