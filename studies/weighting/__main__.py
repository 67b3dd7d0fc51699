"""Does symbolic weighting help? `docs/weighting.md`, its figure and its table, from nothing.

NPROC=1 python -m studies.weighting DATA docs/weighting.csv [SET ...]

DATA holds HERMES's runs in `hermes` and ETH/UCY in `eth_ucy`, see
`studies/weighting/data.py`. What is asked, and what would be an answer, was written
before the first run: studies/weighting/protocol.md. The table has a row for each run
and metric. Runs that it has are not done again, so delete the rows of what is to be
repeated; with one thread a run gives the same bits. The page and the figure are written
beside the table.
"""

import csv
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax
from tqdm import tqdm

from neurosym_jax.errors import InputWarning
from neurosym_jax.runtime import enable_compilation_cache, tune
from studies.weighting.arms import ARMS, SETS
from studies.weighting.data import load
from studies.weighting.page import write
from studies.weighting.scores import score
from studies.weighting.training import train

HEAD = ("set", "arm", "seed", "metric", "value", "counted")


def run_all(data: Path, table: Path, names: Sequence[str]) -> None:
    """Do the runs of these sets that the table lacks, seed by seed."""
    done = set()
    if table.is_file():
        with table.open() as file:
            done = {
                (int(row["seed"]), row["set"], row["arm"])
                for row in csv.DictReader(file)
            }
    planned = {
        (seed, name, title)
        for name in names
        for title, arm in ARMS.items()
        for seed in range(arm.seeds.get(name, 0))
    }
    sets = {}
    for seed, name, title in tqdm(sorted(planned - done), unit="run"):
        if name not in sets:
            sets[name] = load(name, data)
        training, test = sets[name]
        arm = ARMS[title]
        params = jax.block_until_ready(train(arm.network, arm.recipe, training, seed))
        with table.open("a", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            if not file.tell():
                rows.writerow(HEAD)
            for metric, (value, count) in score(arm.network, params, test).items():
                rows.writerow(
                    [name, title, seed, metric, f"{value:.6f}", f"{count:.0f}"]
                )


if __name__ == "__main__":
    warnings.simplefilter("ignore", InputWarning)
    enable_compilation_cache()
    tune()
    run_all(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] or SETS)
    write(Path(sys.argv[2]))
