"""SGAN and NeuroSyM trained with the same loss: the release's comparison, repeated fairly.

NPROC=1 python -m studies.same_loss DATA docs/same_loss.csv   # the runs that the table lacks
python -m studies.same_loss docs/same_loss.csv                # what they say, in Markdown

DATA is ETH/UCY. What is asked was written before the first run:
studies/weighting/protocol.md. The table has a row for each run, step and metric. Runs
that it has are not done again, so an interrupted command continues, and a run whose
rows are deleted repeats to the bit.
"""

import csv
import dataclasses
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
from jax import Array

from neurosym_jax.data.recordings import Source, open_source
from neurosym_jax.data.windows import Batch, cut_windows, make_batches
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.models.sgan.network import GeneratorConfig, register_pooling
from neurosym_jax.models.sgan.pooling import AsDescribed, NeurosymIjcnn, NeurosymRos
from neurosym_jax.models.sgan.training import RECIPES
from neurosym_jax.symbolic.weighting import Cnd, CndShipped
from neurosym_jax.training.run import ROUND, Run
from studies import print_or_run
from studies.weighting.comparison import ALIVE, Runs, adjusted, answer, percent_text

__all__ = ["LOSSES", "NETWORKS", "Zeros", "report", "run_all"]

TESTED = (1000, 2000, 3000)
"""Generator steps after which a run is tested, to see whether more of them would matter."""
SEEDS = range(6)
PLACES = ("zara1", "hotel")
FLAT = 0.02
"""Share by which an arm's validation error falls at most over the last thousand steps of a flat
curve."""
SET = pl.concat_str("place", "loss", separator=", ")
METRICS = ("joint_ade", "joint_fde", "energy_score", "neighbour_near")
HEAD = ("place", "loss", "network", "seed", "step", "split", "metric", "value")

VARIETY = dataclasses.replace(RECIPES["sgan"], steps=TESTED[-1], batch_scenes=10)
LOSSES = {
    "variety": VARIETY,
    "adversarial": dataclasses.replace(
        VARIETY,
        variety_weight=0.0,
        best_k=1,
        discriminator_steps=2,
        clip_norm=0.0,
        discriminator=dataclasses.replace(VARIETY.discriminator, kind="local"),
    ),
}
"""The arguments of the released NeuroSyM networks, and of the release's "no alpha" baselines."""


IJCNN: Any = NeurosymIjcnn.variant


class _ZerosNetwork(IJCNN):
    """The earlier release's pooling, served rows of pairs of different people."""

    def __call__(self, hidden: Array, valid: Array) -> Array:
        """[N, bottleneck_dim], all rows equal."""
        rows = jnp.zeros((hidden.shape[0], self.obs_len))
        return super().__call__(hidden=hidden, valid=valid, alpha_rows=rows)


@register_pooling("neurosym_ijcnn_zeros", replace=True)
@dataclasses.dataclass(frozen=True)
class Zeros(NeurosymIjcnn):
    """The earlier release with the weights that its reader makes of the CND's table: all 0."""

    title = "NeuroSyM (IJCNN release), weights 0"
    inputs = frozenset({"hidden"})
    variant = _ZerosNetwork


NETWORKS = {
    "sgan": GeneratorConfig(),
    "ijcnn": GeneratorConfig(pooling=Zeros()),
    "ros": GeneratorConfig(pooling=NeurosymRos(), weighting=CndShipped()),
    "described": GeneratorConfig(pooling=AsDescribed(), weighting=Cnd()),
}


def train_and_test(
    run: Run, splits: dict[str, list[Batch]]
) -> Iterator[tuple[int, str, str, float]]:
    """Rows of step, split, metric and value; the last state is tested, not the best.

    A `d_loss` of 2 log 2 is that of a discriminator whose last ReLU is shut: it teaches
    nothing.
    """
    state, advance, forecaster = run.init_state(), run.rounds(), run.forecaster
    for done in range(0, run.recipe.steps, ROUND):
        state, metrics = advance(state, done, ROUND)
        if (step := done + ROUND) not in TESTED:
            continue
        yield step, "train", "d_loss", float(metrics["d_loss"].mean())
        params = jax.tree.map(jnp.copy, state.params)
        for split, batches in splits.items():
            scores = score_forecaster(
                forecaster, params, batches, samples=20, seed=0, metrics=METRICS
            ).scores
            for metric, score in scores.items():
                yield step, split, metric, float(score.mean)


def run_all(source: Source, table: Path) -> None:
    """Do the runs that `table` lacks: all arms of a seed before the next seed."""
    finished = set()
    if table.is_file():
        with table.open() as file:
            rows = [*csv.DictReader(file)]
        finished = {
            (row["place"], row["loss"], row["network"], int(row["seed"]))
            for row in rows
        }
    else:
        table.write_text(",".join(HEAD) + "\n")
    arms = [*itertools.product(NETWORKS, PLACES, LOSSES)]
    for seed in SEEDS:
        for name, place, loss in arms:
            if (place, loss, name, seed) in finished:
                continue
            network = NETWORKS[name]
            training, validation, test = (
                cut_windows(
                    source.recordings(place, split), network.obs_len, network.pred_len
                )
                for split in ("train", "val", "test")
            )
            recipe = dataclasses.replace(LOSSES[loss], seed=seed)
            splits = {"val": make_batches(validation), "test": make_batches(test)}
            rows = [*train_and_test(Run(network, recipe, training, validation), splits)]
            # All rows of a run at once: a table never holds a part of one.
            lines = [
                (place, loss, name, seed, *row[:3], f"{row[3]:.6f}") for row in rows
            ]
            with table.open("a", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(lines)
            print(*lines[-4:], sep="\n", flush=True)


def report(rows: pl.DataFrame) -> str:
    """A table of errors and of differences to SGAN's, and what else the protocol asks for.

    Counted are the seeds that the most arms have, as the protocol says: in the end,
    all.
    """
    joint = rows.filter(metric="joint_ade", split="test", step=TESTED[-1])
    arms = joint.group_by("seed").agg(pl.len())
    seeds = arms.filter(pl.col("len") == pl.col("len").max())["seed"].to_list()
    rows = rows.filter(pl.col("seed").is_in(seeds))
    last = rows.filter(split="test", step=TESTED[-1])
    runs = Runs(
        last.rename({"network": "arm"}).with_columns(set=SET).filter(metric="joint_ade")
    )
    sets = last.select(SET.alias("set"))["set"].unique(maintain_order=True)
    others = [name for name in NETWORKS if name != "sgan"]
    pairs = [
        runs.compare(name, other, "sgan", "joint_ade")
        for name in sets
        for other in others
    ]
    comparisons = adjusted([pair for pair in pairs if pair is not None])
    differences = {(pair.dataset, pair.arm): pair for pair in comparisons}
    lines = []
    for network in NETWORKS:
        lines.append([network])
        for name in sets:
            cell = f"{np.mean([*runs.values(name, network, 'joint_ade').values()]):.3f}"
            if pair := differences.get((name, network)):
                words = {"helps": " **ahead**", "harms": " **behind**"}
                cell += f" ({percent_text(pair)}){words.get(answer(pair), '')}"
            lines[-1].append(cell)
    near = last.filter(metric="neighbour_near")
    still = near.group_by("loss", maintain_order=True).agg(
        (pl.col("value") < ALIVE).sum(), runs=pl.len()
    )
    ignoring = ", ".join(
        f"{loss} {count} of {runs}" for loss, count, runs in still.iter_rows()
    )
    arm = ["place", "loss", "network"]
    validation = rows.filter(metric="joint_ade", split="val").group_by(arm)
    means = validation.agg(
        *(
            pl.col("value").filter(pl.col("step") == step).mean().alias(str(step))
            for step in TESTED
        )
    )
    before, after = (means[str(step)] for step in TESTED[-2:])
    shut = rows.filter(
        pl.col("value").is_close(2 * math.log(2), abs_tol=1e-4), metric="d_loss"
    )
    shut = shut.filter(step=TESTED[0]).group_by("loss", maintain_order=True).len()
    closed = ", ".join(f"{loss} {count}" for loss, count in shut.iter_rows()) or "none"
    return f"""{markdown_table(["joint ADE", *sets], lines, right=len(sets))}

Seeds: {len(seeds)}. Curves that are flat: {(after > (1 - FLAT) * before).sum()} of {len(means)}.
Networks that ignore neighbours: {ignoring}.
Discriminators that are shut after {TESTED[0]:,} steps: {closed}."""


if __name__ == "__main__":
    print_or_run(report, lambda data, table: run_all(open_source(data), Path(table)))
