r"""A page of what the benchmarks measured; `studies/pages/benchmarks.md` is it, by one command.

python -m benchmarks --data DATA --checkpoints FOLDER --reference SGAN \
    --neurosym-reference NEUROSYM --json docs/benchmarks.json --page studies/pages/benchmarks.md
"""

import itertools
import textwrap
from typing import Any

from benchmarks.timing import OURS

HEAD = """# Benchmarks, all rows

How long does each part take, beside torch and the released code? Evaluation and training steps are
as fast or faster, and so are single scenes but those of ten people. In the tables `anchors` is [`recommended`](../../docs/benchmarks.md).

{commits}
"""

TAIL = """<details markdown="1">
<summary>How this was measured</summary>

- Contestants run in a process each, and their rounds alternate. The tables have medians, in brackets
  the CPU's seconds. After a colon stands the ratio to ours, with the least and the most that the
  rounds allow.
- Timings on this machine vary threefold between hours: compare within a row only.
- For the age, ROS 1 is a real roscore with samples out, ROS 2 a real rclpy with poses in and markers
  out. A bag is replayed at its own rate, and its ages are those that `neurosym replay` prints. All
  200 people are forecast (`--max-people 200`).
- "Start" compiles everything first, "meanwhile" while people are forecast already; "warm" has
  programs in the cache.
- The torch peer is SGAN with encoding and pooling done once, all samples together, and no loop over
  scenes. The original is the released code.
- `docs/benchmarks.json` has all rounds, stages, memory, and the bound set by the
  arithmetic. The first lines of `benchmarks/page.py` renew the page.

{machine}

</details>
"""

AGE = ["", "median", "99 % below", "frames with a forecast", "page's frames a second"]
SCALING = ["", "size: median", "exponent", "memory at most"]
HIDDEN = (
    *(
        "7 Hz",
        "somebody is",
        "longest",
        "latest",
        "imports",
        "no-coll",
        "plain",
        "evaluate.py,",
    ),
    "all forty",
)
"""Parts of names of the rows that stand in the JSON file alone."""
TITLES = {
    "zoo": "evaluation",
    "training": "training step",
    "trainings": "whole training, zara1, 8 + 12",
    "symbols": "QTC and alpha",
    "online": "from a frame to 20 forecasts",
    "age": "From a frame's stamp to its forecast at a listener",
    "start": "process",
    "reading": "reading",
    "scaling": "Scaling",
    "numeric": "tests of numbers",
    "place": "a frame where a place is watched",
}


def document(benchmarks: dict[str, Any]) -> str:
    """The whole page."""
    machine = next(iter(benchmarks.values()))["machine"]
    device = "" if machine["platform"] == "cpu" else f", {machine['device']}"
    about = (
        f"Machine: {machine['cores']} cores, {machine['cpu']}{device}; Python {machine['python']}, "
        f"jax {machine['jax']}, {machine['platform']}."
    )
    compared, alone = [], []
    for name, title in TITLES.items():
        cases: dict[str, dict[str, Any]] = {}
        for row in benchmarks.get(name, {"rows": []})["rows"]:
            if not any(part in f"{row['case']} {row['who']} " for part in HIDDEN):
                cases.setdefault(row["case"], {})[row["who"]] = row
        for case, rows in cases.items():
            (compared if len(rows) > 1 and OURS in rows else alone).append(
                (title, case, rows)
            )
    who_is_compared = itertools.chain(*(rows for *_, rows in compared))
    others = [who for who in dict.fromkeys(who_is_compared) if who != OURS]
    lines = []
    for title, case, rows in compared:
        ratios = [_ratio(rows, who) for who in others]
        lines.append([f"{title}: {case}", _spent(rows[OURS]), *ratios])
    parts = [
        HEAD.format(commits=_commits(benchmarks)),
        "## Compared\n",
        _table(["", "ours", *others], lines),
        "## Ours alone\n",
    ]
    single = []
    for title, _, rows in alone:
        single += [(title, row) for row in rows.values()]
    ages = [row for title, row in single if title == TITLES["age"]]
    growing = [row for title, row in single if title == TITLES["scaling"]]
    rows = [
        [f"{title}: {row['case']}", _seconds(row["median"])]
        for title, row in single
        if row not in ages + growing
    ]
    parts.append(_table(["", "median"], rows))
    if growing:
        parts += [f"## {TITLES['scaling']}\n", _table(SCALING, _series(growing))]
    if ages:
        parts += [f"## {TITLES['age']}\n", _table(AGE, _ages(ages))]
    return "\n".join([*parts, TAIL.format(machine=about)])


def _commits(benchmarks: dict[str, Any]) -> str:
    """Lines that name the commit at which each benchmark was measured."""
    names: dict[str, list[str]] = {}
    for name in TITLES:
        commit = benchmarks.get(name, {}).get("machine", {}).get("commit")
        if commit:
            dirty = "-dirty" if commit.endswith("-dirty") else ""
            names.setdefault(f"{commit[:8]}{dirty}", []).append(f"`{name}`")
    if not names:
        return "The commit of the code that was timed is not recorded."
    parts = [f"{commit} ({', '.join(timed)})" for commit, timed in names.items()]
    words = f"The code that was timed is that of {', '.join(parts)}; later code was not timed."
    return textwrap.fill(words, 100)


def _ages(rows: list[dict[str, Any]]) -> list[list[str]]:
    lines = []
    for row in rows:
        answered = f"{row['answered']:.0%}" if "answered" in row else ""
        drawn = f"{row['drawn']:.0f}" if "drawn" in row else ""
        times = [_seconds(row["median"]), _seconds(row["p99"])]
        lines.append([row["case"], *times, answered, drawn])
    return lines


def _series(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A line for what grows, with the exponent from its last two sizes."""
    lines = []
    for title, series in itertools.groupby(
        rows, lambda row: row["case"].rpartition(":")[0]
    ):
        *_, last = by_size = list(series)
        sizes = ", ".join(
            f"{row['size']:,}: {_seconds(row['median'])}" for row in by_size
        )
        peaks = [row["peak_mb"] for row in by_size if "peak_mb" in row]
        memory = f"{max(peaks) / 1000:.1f} GB" if peaks else ""
        lines.append([title, sizes, f"{last['exponent']:.1f}", memory])
    return lines


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _ratio(rows: dict[str, Any], who: str) -> str:
    if who not in rows:
        return ""
    own, other = rows[OURS], rows[who]
    parts = zip(
        (other["low"], other["median"], other["high"]),
        (own["high"], own["median"], own["low"]),
    )
    low, ratio, high = (_digits(a / b) for a, b in parts)
    return f"{_spent(other)}: {ratio} ({low} to {high})"


def _spent(row: dict[str, Any]) -> str:
    """Seconds, and those of all cores."""
    cpu = f" ({_seconds(row['cpu'])})" if "cpu" in row else ""
    return _seconds(row["median"]) + cpu


def _digits(value: float) -> str:
    return f"{value:.1f}" if value < 10 else f"{value:.0f}"


def _seconds(value: float) -> str:
    if value >= 0.5:
        return f"{_digits(value)} s"
    return f"{_digits(1000 * value)} ms"
