"""The page, its figure and its table, of the runs that are there."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.plotting.style import save_figure
from neurosym_jax.runtime.files import write_text
from studies.weighting.alpha import interacting_share, spread
from studies.weighting.arms import ARMS, RECIPE, SETS
from studies.weighting.comparison import LEVEL, MARGIN, Comparison, adjusted, compare, verdict
from studies.weighting.figure import forest
from studies.weighting.text import ANSWER, TEXT, TITLES

__all__ = ["write"]

Runs = Mapping[str, Mapping[str, Mapping[int, ErrorsByScene]]]
"""By set, arm and seed."""

PRIMARY = ("interacting joint_ade", "interacting energy_score")
WITHDRAWN = ("SGAN", "NeuroSyM ones", "NeuroSyM 1/15", "NeuroSyM quantised")
"""Arms whose networks ignored their neighbours."""
CONTROL = (("right", "ones"), ("right", "wrong"))
REAL = (("quantised", "ones"), ("quantised", "shuffled"))


def write(runs: Runs, windows: Mapping[str, tuple[Windows, Windows]], out: Path) -> None:
    """Write `weighting.md`, `weighting.csv` and `weighting.png` to `out`."""
    rows = {
        name: [
            compare(arm, "ones", arms, PRIMARY[0])
            for arm in ARMS
            if arm != "ones" and arm not in WITHDRAWN and _seeds(arms, arm) > 1
        ]
        for name, arms in runs.items()
    }
    save_figure(forest(rows, TITLES), out / "weighting.png")
    write_text(out / "weighting.csv", _table_of_runs(runs))
    write_text(out / "weighting.md", _document(runs, windows))


def _seeds(arms: Mapping[str, Mapping[int, ErrorsByScene]], arm: str) -> int:
    return len(arms.get(arm, {}))


def _table_of_runs(runs: Runs) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["set", "arm", "seed", "metric", "value", "counted"])
    for name, arms in runs.items():
        for arm, seeds in arms.items():
            for seed, errors in seeds.items():
                for metric, value, count in zip(
                    errors.metrics, errors.mean, errors.counts.sum(axis=0)
                ):
                    table.writerow([name, arm, seed, metric, f"{value:.6f}", f"{count:.0f}"])
    return text.getvalue()


def _document(runs: Runs, windows: Mapping[str, tuple[Windows, Windows]]) -> str:
    primary = [
        (name, compare(*pair, runs[name], metric))
        for name in SETS[1:]
        for metric in PRIMARY
        for pair in REAL
    ]
    control = [compare(*pair, runs["control"], PRIMARY[0]) for pair in CONTROL]
    seen = all(each.percent < 0 and each.p < LEVEL for each in control)
    p, equivalent = adjusted([each for _, each in primary])
    answers = {}
    for name in SETS[1:]:
        at = [
            index
            for index, (of, each) in enumerate(primary)
            if of == name and each.metric == PRIMARY[0]
        ]
        answers[name] = verdict([primary[index][1] for index in at], p[at], equivalent[at], seen)
    return TEXT.format(
        answer=ANSWER,
        verdicts="; ".join(f"{name}: **{answer}**" for name, answer in answers.items()),
        steps=RECIPE.steps,
        scenes=RECIPE.batch_scenes,
        margin=MARGIN,
        primary=_comparisons(primary, p, equivalent),
        worth=_worth(runs, windows),
    )


def _comparisons(
    found: list[tuple[str, Comparison]],
    p: np.ndarray | None = None,
    equivalent: np.ndarray | None = None,
) -> str:
    """A row a comparison; p values are adjusted ones, if they are given."""
    rows = [
        [
            name,
            f"{each.arm} − {each.reference}",
            _plain(each.metric).removesuffix(", interacting"),
            f"{_percent(each.percent)} % ({_percent(each.low)} to {_percent(each.high)})",
            _p(each.p if p is None else p[index]),
            _p(each.p_equivalent if equivalent is None else equivalent[index]),
        ]
        for index, (name, each) in enumerate(found)
    ]
    head = ["data", "arms", "error", "difference (95 %)", "p, different"]
    return markdown_table([*head, f"p, within {MARGIN:g} %"], rows, right=3)


def _worth(runs: Runs, windows: Mapping[str, tuple[Windows, Windows]]) -> str:
    rows = []
    for name, (learned, tested) in windows.items():
        varies = [
            f"{100 * spread(tested, weighting)[0]:.0f} %" for weighting in ("cnd", "quantised")
        ]
        rows.append(
            [
                name,
                f"{learned.scenes} / {tested.scenes}",
                f"{100 * interacting_share(tested):.0f} %",
                *varies,
                _difference(runs[name], ("ones", "no pooling")),
            ]
        )
    head = ["data", "scenes learned / tested", "interacting", "spread of `cnd`"]
    return markdown_table([*head, "of `quantised`", "`encounter`"], rows, right=5)


def _difference(
    arms: Mapping[str, Mapping[int, ErrorsByScene]],
    pair: tuple[str, str],
    metric: str = PRIMARY[0],
) -> str:
    """Per cent and interval, or nothing where an arm has less than two runs."""
    if min(_seeds(arms, arm) for arm in pair) < 2:
        return ""
    each = compare(*pair, arms, metric)
    return f"{_percent(each.percent)} % ({_percent(each.low)} to {_percent(each.high)})"


def _percent(value: float) -> str:
    return f"{value:+.1f}".replace("-", "−")


def _plain(metric: str) -> str:
    group, name = metric.split(" ")
    words = {"central_ade": "k = 1 ADE", "excess_collisions": "excess collisions"}
    name = words.get(name, name.replace("_", " ").replace("ade", "ADE").replace("fde", "FDE"))
    return f"{name}, {group}"


def _p(value: float) -> str:
    return "< .001" if value < 0.001 else f"{value:.3f}".removeprefix("0")
