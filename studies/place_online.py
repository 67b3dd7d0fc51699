"""What does `neurosym evaluate --online` say of recordings of three minutes and more?

    NPROC=1 python -m studies.place_online DATA THOR MORE OUT  # writes docs/place_online.csv
    python -m studies.place_online                             # from docs/place_online.csv

DATA, THOR and MORE are those of `studies.place`, as are the recordings and the models.
OUT gets a report for each recording; a finished report is not repeated. Recordings of
few people come first, so that a run that is ended early has as many as it can.

Here all is as a user has it: whole scenes, 100 draws of each instead of exact scores, and the
best of 20 samples.
"""

import subprocess
import sys
from pathlib import Path

import polars as pl

from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.evaluation.compare import read_report
from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.evaluation.tables import markdown_table
from studies.place import CHOSEN_ON, MINUTES, places

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "place_online.csv"
METRICS = {
    "person_energy": "energy of a person",
    "energy_score": "energy of a scene",
    "joint_ade": "joint ADE",
}
PRED_LEN = 12


def run(data: Path, thor: Path, more: Path, out: Path) -> None:
    """Evaluate each recording that has no report yet, and write the table of all reports."""
    out.mkdir(parents=True, exist_ok=True)
    for name, (model, path) in places(data, thor, more).items():
        report = out / f"{name}.json"
        if not report.is_file() and _minutes(path) >= MINUTES:
            evaluate(model, path, report)
            _write(data, thor, more, out)


def evaluate(model: str, path: Path, report: Path) -> None:
    """Run the command on one recording."""
    command = [sys.executable, "-m", "neurosym_jax", "evaluate", "--online"]
    command += ["--data", str(path), "--model", model, "--pred-len", str(PRED_LEN)]
    command += ["--baselines", "constant_velocity"]
    command += ["--metrics", "person_energy", "energy_score", "--json", str(report)]
    subprocess.run(command, check=True, stdout=sys.stderr)


def _minutes(path: Path) -> float:
    recordings = recordings_in(path)
    begin = min(tracks.stamp.min() for tracks in recordings)
    end = max(tracks.stamp.max() for tracks in recordings)
    return (end - begin) / 60


def _write(data: Path, thor: Path, more: Path, out: Path) -> None:
    """Write the rows of all reports, with and without the memory."""
    parts = []
    for name in places(data, thor, more):
        report = out / f"{name}.json"
        if report.is_file():
            rows = read_report(report).filter(pl.col("model") != "constant velocity")
            columns = "online", "scenes", "agents", *METRICS
            parts.append(rows.select(pl.lit(name).alias("place"), *columns))
    pl.concat(parts, how="vertical_relaxed").write_csv(TABLE, float_precision=5)


def page(table: pl.DataFrame) -> str:
    """The table of recordings, and means with intervals."""
    changes = []
    for (name,), part in table.group_by("place", maintain_order=True):
        (alone,) = part.filter(~pl.col("online")).iter_rows(named=True)
        (online,) = part.filter(pl.col("online")).iter_rows(named=True)
        change = {key: 100 * (online[key] / alone[key] - 1) for key in METRICS}
        scene = {"place": name, "scenes": alone["scenes"], "people": alone["agents"]}
        changes.append({**scene, "alone": alone["person_energy"], **change})
    frame = pl.DataFrame(changes)
    cells = []
    for row in frame.iter_rows(named=True):
        mark = "\\*" if row["place"] in CHOSEN_ON else ""
        percent = [f"{row[key]:+.1f}" for key in METRICS]
        counts = [f"{row[key]:.0f}" for key in ("scenes", "people")]
        cells.append([row["place"] + mark, *counts, f"{row['alone']:.3f}", *percent])
    head = ["recording", "scenes", "people", "energy alone, m"]
    head += [f"{words}, %" for words in METRICS.values()]
    lines = [markdown_table(head, cells, right=6), ""]
    parts = {
        "without those marked *": frame.filter(~pl.col("place").is_in(CHOSEN_ON)),
        "all recordings": frame,
    }
    for recordings, part in parts.items():
        for key, words in METRICS.items():
            values = part[key].to_list()
            mean, half = sum(values) / len(values), student_half(values)
            count = f"({len(values)})"
            lines.append(f"{recordings}, {words}: {mean:+.1f} ± {half:.1f} % {count}")
    return "\n".join(lines)


if __name__ == "__main__":
    if sys.argv[1:]:
        run(*(Path(name).resolve() for name in sys.argv[1:]))
    else:
        print(page(pl.read_csv(TABLE)))
