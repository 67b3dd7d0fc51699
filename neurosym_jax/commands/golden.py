"""Make golden cases from a torch checkout of SGAN."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.interop import parity
from neurosym_jax.runtime.files import new_folder

__all__ = ["Options", "run"]

SCRIPT = Path(parity.__file__).with_name("torch_side.py")
"""Run by the interpreter that has torch, never imported here."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Let torch code of SGAN forecast, and save what goes in and comes out as golden cases."""

    torch_checkout: Path
    """Folder of SGAN's code, which has `sgan/models.py`; what is in it is run."""
    out: Path
    """Folder to make; nothing is overwritten. `neurosym parity` compares it."""
    checkpoint: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    """Files of its training, a case each; default: networks of all poolings with fresh weights."""
    python: str = sys.executable
    """Interpreter that has torch and numpy."""
    seed: int = 0
    """Of scenes, noise and fresh weights."""


def run(options: Options) -> None:
    """Write the folder of cases.

    Raises:
        InputError: for a checkout or a checkpoint that is not there, an interpreter without torch,
            a folder that is there already, and whatever the other code says when it fails.
    """
    refuse(Seed, {"--seed": options.seed})
    if not (options.torch_checkout / "sgan" / "models.py").is_file():
        raise InputError(
            f"{options.torch_checkout}: has no sgan/models.py, so it is not SGAN's code"
        )
    for path in options.checkpoint:
        if not path.is_file():
            raise InputError(f"{path}: no such checkpoint")
    with new_folder(options.out) as folder:
        given = {
            "checkout": str(options.torch_checkout.resolve()),
            "checkpoints": [str(path.resolve()) for path in options.checkpoint],
            "out": str(folder.resolve()),
            "seed": options.seed,
        }
        try:
            # As text, for beside the file lie others of ours, of which one is called `torch`.
            done = subprocess.run(
                [options.python, "-c", SCRIPT.read_text(encoding="utf-8"), json.dumps(given)],
                cwd=options.torch_checkout,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
        except OSError as error:
            raise InputError(f"--python {options.python}: {error.strerror}") from None
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise InputError(f"--python {options.python}: SGAN's code failed: {last}")
    cases = len(json.loads((options.out / "manifest.json").read_text()))
    print(f"{cases} cases in {options.out}; compare them with: neurosym parity {options.out}")
