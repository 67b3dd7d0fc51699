"""Does a place that is watched lower the error of the best of 20 samples? (`models.place.samples`)

    NPROC=1 python -m studies.place_samples DATA THOR MORE  # writes docs/place_samples.csv
    python -m studies.place_samples                         # from docs/place_samples.csv

DATA, THOR and MORE are those of `studies.place`, as are the recordings and the models. A
recording that is in the table is not run again, nor one of less than three minutes.

Protocol, written before the run over all recordings:

- A place watches its recording from the beginning. Of the scenes of 8 + 12 steps with two
  people or more 100 are scored, evenly spaced over the recording (all, if fewer).
- The network's 20 samples are compared with those of which some are exchanged by the
  memory of the place, `neurosym evaluate --online`. One seed.
- The measure is the joint ADE of the best sample, with joint FDE and marginal ADE beside
  it, means over people. A place's change is the ratio of both.
- Six exchanged everywhere, whatever the memory's share, was the first rule. It lowered
  the joint ADE of hotel by 15 % and raised that of eth by 8 to 14 %, and was tried on
  seven others. The second, whose weight is half of the memory's share, was chosen on
  hotel, eth and THÖR 1, and run over all: joint ADE -2.8 ± 1.3 %, marginal ADE
  +1.9 ± 1.4 %. So the present one minimises the sum of both expected errors. It was
  chosen on hotel, eth, zara1 and THÖR 1 after that run. Recordings on which a rule was
  looked at alone are marked, as are those on which the memory was chosen
  (`studies.place`).
- The interval is Student's over recordings that are not marked, 95 %, of the change in
  per cent.
"""

import sys
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.clock import on_grid
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.evaluation.online import recall_batches
from neurosym_jax.evaluation.scores import score_forecaster
from neurosym_jax.evaluation.tables import markdown_table
from neurosym_jax.models.disk import find_model, load_model
from studies.place import CHOSEN_ON, MINUTES, places

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "place_samples.csv"
SCENES = 100
LOOKED_AT = ("THÖR 1", "THÖR 3", "hyang_4", "gates_0", "gates_1", "nexus_0")
"""Where a rule of exchange was looked at before the present one was chosen."""
METRICS = ("joint_ade", "joint_fde", "marginal_ade")


def run(data: Path, thor: Path, more: Path) -> None:
    """Score every recording of three minutes that is not in the table yet."""
    for name, (model_name, path) in places(data, thor, more).items():
        done = pl.read_csv(TABLE) if TABLE.is_file() else pl.DataFrame()
        if len(done) and name in done["place"].unique():
            continue
        recordings = recordings_in(path)
        begins = min(tracks.stamp.min() for tracks in recordings)
        minutes = (max(tracks.stamp.max() for tracks in recordings) - begins) / 60
        if minutes < MINUTES:
            continue
        rows = score_place(model_name, recordings)
        rows = rows.select(
            pl.lit(name).alias("place"), pl.lit(minutes).alias("minutes"), pl.all()
        )
        pl.concat([done, rows], how="diagonal_relaxed").write_csv(
            TABLE, float_precision=5
        )
        change = rows["joint_ade"][1] / rows["joint_ade"][0] - 1
        print(name, f"{100 * change:+.1f} %", file=sys.stderr, flush=True)


def score_place(model_name: str, recordings: list[Tracks]) -> pl.DataFrame:
    """A row with and without the memory: scenes and people that are scored, and errors in metres."""
    model = load_model(find_model(model_name))
    config = model.config
    tracks = [on_grid(each, config.period) for each in recordings]
    windows = cut_windows(tracks, config.obs_len, config.pred_len, min_agents=2)

    spaced = np.linspace(0, windows.scenes - 1, min(SCENES, windows.scenes))
    some = windows.take(spaced.round().astype(int))
    batches = make_batches(some, slots=64)
    memories = recall_batches(model, some, batches, tracks)
    rows = []
    for arm, memory in {"network": None, "memory": memories}.items():
        scores = score_forecaster(
            model.forecaster,
            model.params,
            batches,
            samples=20,
            seed=0,
            metrics=METRICS,
            memories=memory,
        ).scores
        means = [float(scores[name].mean) for name in METRICS]
        rows.append((arm, some.scenes, some.agents, *means))
    columns = ["arm", "scenes", "people", *METRICS]
    return pl.DataFrame(rows, schema=columns, orient="row")


def page(table: pl.DataFrame) -> str:
    """The table of places, and means with intervals."""
    cells, changes = [], []
    for (name,), part in table.group_by("place", maintain_order=True):
        network, memory = part.iter_rows(named=True)
        change = [100 * (memory[m] / network[m] - 1) for m in METRICS]
        mark = "\\*" if name in (*CHOSEN_ON, *LOOKED_AT) else ""
        if not mark:
            changes.append(change)
        cells.append(
            [
                f"{name}{mark}",
                f"{network['minutes']:.1f}",
                f"{network['people']:.0f}",
                f"{network['joint_ade']:.3f}",
                *(f"{value:+.1f}" for value in change),
            ]
        )
    head = ["recording", "minutes", "people", "joint ADE, m"]
    names = ["joint ADE, %", "joint FDE, %", "marginal ADE, %"]
    lines = [markdown_table([*head, *names], cells, right=6), ""]
    for name, values in zip(names, np.array(changes).T):
        half = student_half(values)
        lines.append(f"{name}: {values.mean():+.1f} ± {half:.1f} ({len(values)})")
    return "\n".join(lines)


if __name__ == "__main__":
    if sys.argv[1:]:
        run(*(Path(name).resolve() for name in sys.argv[1:]))
    else:
        print(page(pl.read_csv(TABLE)))
