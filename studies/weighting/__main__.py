"""Does symbolic weighting help? `docs/weighting.md`, its figure and its table, from nothing.

NPROC=1 python -m studies.weighting DATA OUT [SET ...]

DATA holds HERMES's runs in `hermes` and ETH/UCY in `eth_ucy`, see `studies/weighting/data.py`.
What is asked, and what would be an answer, was written before the first run:
docs/weighting_protocol.md. A finished run lies in OUT/runs and is not done again; with names of
sets only theirs are done, so that processes can share them. OUT gets `weighting.md`,
`weighting.csv` and `weighting.png`, of all runs that are there. With one thread a run gives the
same bits again.
"""

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.runtime import enable_compilation_cache, tune
from neurosym_jax.runtime.files import new_file
from studies.weighting.arms import ARMS, RECIPE, SETS
from studies.weighting.data import load
from studies.weighting.scores import score
from studies.weighting.training import train

FIRST = 12
"""Seeds of the arms that answer the questions, before any of the others."""


def runs() -> list[tuple[int, str, str]]:
    """(Seed, set, arm) of every run in their order: see the protocol."""
    every = [
        (seed, name, arm)
        for name in SETS
        for arm, how in ARMS.items()
        for seed in range(how.seeds[name])
    ]
    return sorted(every, key=lambda run: run[0] + (0 if ARMS[run[2]].first else FIRST))


def path_of(out: Path, seed: int, name: str, arm: str) -> Path:
    """Where the scores of a run are."""
    return out / "runs" / f"{name}_{arm.replace(' ', '-').replace('/', '-')}_{seed}.npz"


def run_all(data: Path, out: Path, names: Sequence[str]) -> None:
    """Do what is left of these sets."""
    left = [run for run in runs() if run[1] in names and not path_of(out, *run).is_file()]
    sets: dict[str, tuple[Windows, Windows]] = {}
    for seed, name, arm in tqdm(left, unit="run"):
        if name not in sets:
            sets[name] = load(name, data)
        learned, tested = sets[name]
        generator = ARMS[arm].generator
        params = jax.block_until_ready(train(generator, RECIPE, learned, seed))
        errors = score(generator, params, tested)
        with new_file(path_of(out, seed, name, arm)) as path, path.open("wb") as file:
            np.savez_compressed(
                file,
                metrics=errors.metrics,
                totals=errors.totals,
                counts=errors.counts,
                identity=errors.identity,
                steps=errors.steps,
            )


def read(path: Path) -> ErrorsByScene:
    """A finished run."""
    with np.load(path) as file:
        return ErrorsByScene(
            tuple(map(str, file["metrics"])),
            file["totals"],
            file["counts"],
            file["identity"],
            int(file["steps"]),
        )


def main(data: Path, out: Path, names: Sequence[str] = SETS) -> None:
    """Train and score the missing runs, and write the page of all finished ones."""
    from studies.weighting.page import write

    enable_compilation_cache()
    tune()
    run_all(data, out, names)
    found = {
        name: {
            arm: {
                seed: read(path)
                for seed in range(how.seeds[name])
                if (path := path_of(out, seed, name, arm)).is_file()
            }
            for arm, how in ARMS.items()
            if how.seeds[name]
        }
        for name in SETS
    }
    write(found, {name: load(name, data) for name in SETS}, out)


if __name__ == "__main__":
    warnings.simplefilter("ignore", InputWarning)
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] or SETS)
