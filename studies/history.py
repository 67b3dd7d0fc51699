"""Symbols over time: is a pair's history of QTC states worth more than geometry's?

NPROC=1 python -m studies.history DATA docs/history.csv   # the runs that the table lacks
python -m studies.history docs/history.csv                # what they say, in Markdown

DATA is that of `studies.weighting`. What is asked was written before the first run:
studies/weighting/protocol.md, fifth part. The table has a row for each run and metric.
Runs that it has are not done again, so an interrupted command continues; with one
thread a run whose rows are deleted repeats to the bit.
"""

import csv
import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
from jax import Array

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.forecasting.forecaster import register_forecaster
from neurosym_jax.models.anchors.forecaster import AnchorsForecaster
from neurosym_jax.models.anchors.frames import (
    LONGEST,
    SLOW,
    closest_approach,
    length,
    turned,
)
from neurosym_jax.models.anchors.network import AnchorConfig
from neurosym_jax.symbolic.qtc import (
    ABSENT,
    adjacency,
    alpha_table,
    encode_state,
    observe,
)
from studies import print_or_run
from studies.weighting.arms import ANCHORS
from studies.weighting.comparison import (
    ENERGY,
    INTERACTING,
    Comparison,
    Runs,
    adjusted,
    answer,
    p_text,
    percent_text,
)
from studies.weighting.control import LENGTHS
from studies.weighting.data import load
from studies.weighting.scores import score
from studies.weighting.training import train

__all__ = ["ARMS", "HistoryConfig", "geometry_history", "register", "report", "run_all"]
__all__ += ["symbol_history"]

HEAD = ("set", "arm", "seed", "metric", "value")
METRICS = (INTERACTING, ENERGY, "all joint_ade", "all energy_score", "neighbour_near")
PLACES = ("corridors", "zara2", "univ")
SEEDS = range(24)
MEAN = "mean"
"""The set of the mean over places."""
Pair = tuple[str, str]
"""An arm and its reference."""
Endpoints = tuple[Comparison, Comparison]
"""A comparison by joint ADE, and the same by the energy score."""
QUESTIONS: tuple[Pair, ...] = (("symbols", "now"), ("both", "geometry"))
"""The primary comparisons."""
FURTHER: tuple[Pair, ...] = (("geometry", "now"), ("symbols", "geometry"))
RECIPE = dataclasses.replace(
    ANCHORS, steps=800, learning_rate=2e-3, batch_scenes=64, batch_people=320
)
"""Faster than the weighting study's, and with fewer networks that ignore neighbours."""
TOLERATED = 0.25
"""An arm with a larger share of networks that ignore neighbours answers nothing."""


@functools.cache
def diagram_distance() -> np.ndarray:
    """[81, 81] least number of transitions between two states of QTC_C1, by state code."""
    from scipy.sparse.csgraph import shortest_path

    return shortest_path(adjacency("c1"), unweighted=True).astype(np.float32)


def symbol_history(states: Array, period: float) -> Array:
    """[..., 4 S + 25] features of a pair's QTC_C1 `states [..., S, 4]`, each of `period` seconds.

    The states, oldest first; of the last one: |symbols|, seconds that each symbol and
    the state have lasted, and share of time in it; the previous state, how many symbols
    changed from it, and the transitions that the diagram has between them; each
    symbol's previous value, the one that the diagram lets a 0 pass on to, and the
    papers' alpha, relative to 1/15.
    """
    states = jnp.where(states == ABSENT, 0, states)
    count, present = states.shape[-2], states[..., -1, :]
    same = states == present[..., None, :]
    lasted = jnp.cumprod(same[..., ::-1, :], axis=-2).sum(-2)
    state_lasted = lasted.min(-1, keepdims=True)

    def before(steps: Array) -> Array:
        """[..., 4] symbols before the last `steps`, 0 where these are all."""
        chosen = np.arange(count)[:, None] == (count - 1 - steps)[..., None, :]
        return jnp.where(chosen, states, 0).sum(-2)

    previous, symbol_before = before(state_lasted), before(lasted)
    changed = state_lasted < count
    code = encode_state(present)
    transitions = jnp.asarray(diagram_distance())[encode_state(previous), code][
        ..., None
    ]
    features = [
        states.reshape(*states.shape[:-2], -1),
        jnp.abs(present),
        *(period * lasted, period * state_lasted, same.all(-1).mean(-1)[..., None]),
        previous,
        jnp.where(changed, (previous != present).sum(-1, keepdims=True), 0),
        jnp.where(changed, transitions, 0),
        *(symbol_before, jnp.where(present == 0, -symbol_before, 0)),
        15 * jnp.asarray(alpha_table(), jnp.float32)[code][..., None],
    ]
    return jnp.concatenate([feature.astype(jnp.float32) for feature in features], -1)


def geometry_history(
    track: Array, others: Array, heading: Array, period: float, radius: float
) -> Array:
    """[..., 7 (T - 1)] features of the tracks `others` as seen from `track`, both [..., T, 2].

    After each step: bearing and relative velocity in the frame of the present `heading
    [..., 2]`, distance, time of the closest approach and how close it is, scaled as the
    present ones are.
    """
    offset = (others - track)[..., 1:, :]
    bearing = turned(offset, heading[..., None, :], -1)
    motion = turned(
        jnp.diff(others - track, axis=-2) / period, heading[..., None, :], -1
    )
    distance = length(offset)[..., None]
    soon, miss = closest_approach(bearing, motion, 0.05, LONGEST)
    approach = jnp.stack([soon, jnp.exp(-2 * miss - soon)], -1)
    near = bearing / jnp.maximum(distance, 1)
    features = jnp.concatenate([near, motion, distance / radius, approach], -1)
    return features.reshape(*features.shape[:-2], -1)


@dataclasses.dataclass(frozen=True)
class HistoryConfig(AnchorConfig):
    """The anchors network, whose attention may also see the past of a pair."""

    past_symbols: bool = False
    """Whether the attention sees the history of QTC_C1 states, at the network's threshold."""
    past_geometry: bool = False
    """Whether the attention sees positions and velocities after each observed step."""

    def pair_features(
        self,
        observed: Array,
        velocity: Array,
        heading: Array,
        valid: Array,
        near: Array | None,
    ) -> tuple[Array, Array, Array]:
        """The present features, nearness and number around, and the history of each near pair."""
        present, gate, crowd = super().pair_features(
            observed, velocity, heading, valid, near
        )
        own, others = observed[:, None], observed[near]  # None adds an axis.
        features = []
        if self.past_symbols:
            factor: Any = SLOW * self.period
            factors = {
                "quantisation_factor": factor,
                "side_quantisation_factor": factor,
            }
            features += [symbol_history(observe(own, others, **factors), self.period)]
        if self.past_geometry:
            history = geometry_history(
                own, others, heading[:, None], self.period, self.radius
            )
            features += [history]
        features = [jnp.where(gate[..., None] > 0, feature, 0) for feature in features]
        return jnp.concatenate([present, *features], -1), gate, crowd


class HistoryForecaster(AnchorsForecaster):
    """An `AnchorNetwork` with the history of pairs."""

    Config: ClassVar[type] = HistoryConfig


def register() -> None:
    """Make the family known; done again, it replaces itself."""
    register_forecaster("history", HistoryForecaster, replace=True)


ARMS = {
    name: HistoryConfig(
        *LENGTHS,
        past_symbols=name in ("symbols", "both"),
        past_geometry=name in ("geometry", "both"),
    )
    for name in ("now", "symbols", "geometry", "both")
}
"""All see the present geometry; `now` nothing else, the others these histories."""


def run_all(data: Path, table: Path) -> None:
    """Do the runs that `table` lacks: all arms and places of a seed before the next seed."""
    register()
    finished = set()
    if table.is_file():
        with table.open() as file:
            finished = {
                (int(row["seed"]), row["set"], row["arm"])
                for row in csv.DictReader(file)
            }
    else:
        table.write_text(",".join(HEAD) + "\n")
    load_place = functools.cache(load)
    for seed, place, arm in itertools.product(SEEDS, PLACES, ARMS):
        if (seed, place, arm) in finished:
            continue
        training, test = load_place(place, data)
        params = jax.block_until_ready(train(ARMS[arm], RECIPE, training, seed))
        scores = score(ARMS[arm], params, test)
        # All rows of a run at once: a table never holds a part of one.
        lines = [
            (place, arm, seed, metric, f"{scores[metric][0]:.6f}") for metric in METRICS
        ]
        with table.open("a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)
        print(*lines[0], *lines[1][3:], *lines[-1][3:], flush=True)


def with_mean(rows: pl.DataFrame) -> pl.DataFrame:
    """The runs of whole seeds, and for each seed and arm the mean over places, as a further set.

    Errors are relative to those of `now` at the same place. The mean's network uses its
    neighbours as much as at the place where it does least.
    """
    counts = rows.filter(metric=METRICS[0]).group_by("seed").len()
    seeds = counts.filter(pl.col("len") == len(PLACES) * len(ARMS))
    rows = rows.join(seeds, on="seed", how="semi")
    level = (
        rows.filter(arm="now")
        .group_by("set", "metric")
        .agg(level=pl.col("value").mean())
    )
    ratio = pl.col("value") / pl.col("level")
    near = pl.col("metric") == "neighbour_near"
    mean = (
        rows.join(level, on=["set", "metric"])
        .group_by("arm", "seed", "metric", maintain_order=True)
        .agg(least=pl.col("value").min(), ratio=ratio.mean())
        .with_columns(
            set=pl.lit(MEAN), value=pl.when(near).then("least").otherwise("ratio")
        )
    )
    return pl.concat([rows, mean.select(rows.columns)])


def report(rows: pl.DataFrame) -> str:
    """Tables of the answers, and of the mean's further comparisons; networks left out, if any."""
    runs = Runs(with_mean(rows), TOLERATED)

    def compare(
        people: str, places: Sequence[str], pairs: Sequence[Pair]
    ) -> list[Endpoints]:
        endpoints = []
        for place, pair in itertools.product(places, pairs):
            joint = runs.compare(place, *pair, f"{people} joint_ade")
            energy = runs.compare(place, *pair, f"{people} energy_score")
            if joint is not None and energy is not None:
                endpoints.append((joint, energy))
        return endpoints

    answers = []
    for places in ((MEAN,), PLACES):
        endpoints = compare("interacting", places, QUESTIONS)
        corrected = adjusted([*itertools.chain(*endpoints)])
        for joint, energy in zip(corrected[::2], corrected[1::2]):
            answers.append(
                [joint.dataset, *_arms(joint), *_answer(joint), *_answer(energy)]
            )
    further = [
        [people, _arms(joint)[0], percent_text(joint), percent_text(energy)]
        for people, pairs in (("interacting", FURTHER), ("all", QUESTIONS))
        for joint, energy in compare(people, [MEAN], pairs)
    ]
    left_out = [
        f"{dead} of {count} of `{arm}` on {place}"
        for place, arm, dead, count in runs.dead.filter(
            pl.col("set") != MEAN
        ).iter_rows()
    ]
    head = [
        "arms",
        "seeds",
        "joint ADE, %",
        "p",
        "answer",
        "energy score, %",
        "p",
        "answer",
    ]
    further_head = ["people", "arms", "joint ADE, %", "energy score, %"]
    return f"""{markdown_table(["place", *head], answers, right=6)}

{markdown_table(further_head, further, right=2)}

Networks left out: {"; ".join(left_out) or "none"}."""


def _arms(comparison: Comparison) -> list[str]:
    return [f"{comparison.arm} − {comparison.reference}", str(comparison.seeds)]


def _answer(comparison: Comparison) -> list[str]:
    verdict = answer(comparison).replace("no effect beyond", "within")
    return [percent_text(comparison), p_text(comparison.p), f"**{verdict}**"]


if __name__ == "__main__":
    print_or_run(report, lambda data, table: run_all(Path(data), Path(table)))
