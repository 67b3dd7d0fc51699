"""A sweep's models compared with a reference: paired by training seed and test scene."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import (
    Difference,
    ErrorsByScene,
    mean_difference,
    paired_difference,
)
from neurosym_jax.evaluation.markdown import csv_text, markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.report import FORMAT, read_report
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.runtime.files import refuse_unwritable, write_json, write_text

__all__ = ["ARRAYS", "ERRORS", "write_report"]

ERRORS = "scenes.npz"
"""Beside `sweep.json`: each trained model's errors, scene by scene."""
ARRAYS = ("metrics", "totals", "counts", "identity")
"""Fields of `ErrorsByScene` that it holds for each row."""
REFERENCES = ("ones", "SGAN")
"""What models are compared with unless other references are named."""
MEAN = "mean"
"""The name of the mean over test sets."""
INTERVALS = """\
Differences are the model's metric less the reference's, on the same scenes with the same noise and
seed: for errors, below 0 is better. In brackets is the 95 % interval: test scenes resampled in
blocks of as many start frames as a window has steps, and the mean over seeds drawn from Student's
t. Bold where it leaves out 0. The mean weighs the test sets equally."""

Row = Mapping[str, Any]
Compared = dict[str, Any]
"""Model, reference, scene; and by metric the difference, its interval and that of each seed."""


def write_report(
    sweep: Path,
    against: Sequence[str] = (),
    *,
    pred_len: int | None = None,
    out: Path | None = None,
) -> str:
    """Compare a sweep's models with references: Markdown; CSV, JSON and a forest plot beside it.

    Args:
        sweep: folder of the sweep.
        against: the references, models by title or by weighting; default: `REFERENCES`, as far as
            the sweep has them, else the other one of two models.
        pred_len: steps forecast, where the sweep has several.
        out: the Markdown's file; default: report.md in the sweep's folder.

    Returns:
        The Markdown, the table of errors, and a line of the files that were written.

    Raises:
        InputError: for a folder without a sweep, or one that lacks what is to be compared.
    """
    target = out or sweep / "report.md"
    if target.suffix != ".md":
        raise InputError(f"--out {target}: must end in .md")
    refuse_unwritable(target)
    rows, errors = _read(sweep)
    chosen = _one_horizon(rows, pred_len)
    models = list(dict.fromkeys(rows[index]["model"] for index in chosen))
    compared = _compare(rows, errors, chosen, [_named(each, models) for each in against], models)
    write_json(target.with_suffix(".json"), {"format": FORMAT, "compared": compared})
    from neurosym_jax.plotting.forest import plot_forest

    plot_forest(compared, target.with_suffix(".png"))
    seeds = len({rows[index]["training_seed"] for index in chosen})
    text = _text(compared, f"{len(chosen)} runs, {seeds} seed{'s' * (seeds > 1)}.", target.stem)
    if seeds < 3:
        text += "\nTwo seeds or one say nothing of how much trainings differ.\n"
    write_text(target, text)
    write_text(target.with_suffix(".csv"), _csv(compared))
    files = ", ".join(str(target.with_suffix(end)) for end in (".md", ".csv", ".json", ".png"))
    return f"{text}\n{format_table(read_report(sweep / 'sweep.json'), 'markdown')}\n\n{files}"


def _read(folder: Path) -> tuple[Sequence[Row], dict[int, ErrorsByScene]]:
    """The rows of a sweep, and by their index the errors of those that were trained."""
    rows = read_report(folder / "sweep.json").to_dicts()
    try:
        errors = {}
        with np.load(folder / ERRORS) as arrays:
            for index, row in enumerate(rows):
                if row["training_seed"] is not None:
                    names, totals, counts, identity = (arrays[f"{n}_{index}"] for n in ARRAYS)
                    steps = row["obs_len"] + row["pred_len"]
                    metrics = tuple(names.tolist())
                    errors[index] = ErrorsByScene(metrics, totals, counts, identity, steps)
        return rows, errors
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: holds no whole sweep ({error}); run the sweep again") from None


def _one_horizon(rows: Sequence[Row], pred_len: int | None) -> list[int]:
    """Indices of the trained rows to compare, which have one horizon."""
    chosen = [at for at, row in enumerate(rows) if row["training_seed"] is not None]
    chosen = [at for at in chosen if pred_len in (None, rows[at]["pred_len"])]
    horizons = sorted({(rows[at]["obs_len"], rows[at]["pred_len"]) for at in chosen})
    if len(horizons) != 1:
        raise InputError(f"horizons in the sweep: {horizons or 'none'}; --pred-len chooses one")
    return chosen


def _named(name: str, models: Sequence[str]) -> str:
    """The model of this title, or whose title ends in `, name`."""
    found = [each for each in models if each == name] or [
        each for each in models if each.endswith(f", {name}")
    ]
    if len(found) != 1:
        what = f"several models are {name!r}" if found else f"no {name!r} to compare with"
        raise InputError(f"--against: {what}: there are {'; '.join(models)}")
    return found[0]


def _compare(
    rows: Sequence[Row],
    errors: Mapping[int, ErrorsByScene],
    chosen: Sequence[int],
    references: Sequence[str],
    models: Sequence[str],
) -> list[Compared]:
    """Every other model against each reference, on each test set and in the mean.

    Seeds that either of the two has not finished on a test set are left out of it, and of the mean.
    """
    if not references:
        endings = tuple(f", {name}" for name in REFERENCES)
        references = [each for each in models if each in REFERENCES or each.endswith(endings)]
    if not references and len(models) == 2:
        references = models[:1]
    if not references or len(models) < 2:
        raise InputError(f"--against names the reference; there are {'; '.join(models)}")
    found: dict[tuple[str, str], dict[int, ErrorsByScene]] = {}
    for at in chosen:
        row = rows[at]
        found.setdefault((row["model"], row["dataset"]), {})[row["training_seed"]] = errors[at]
    compared = []
    for reference in references:
        for model in models:
            if model == reference:
                continue
            scenes = [scene for of, scene in found if of == model]
            parts, means = [], []
            for scene in scenes:
                ours, theirs = found[model, scene], found.get((reference, scene), {})
                seeds = sorted(ours.keys() & theirs.keys())
                if not seeds:
                    raise InputError(f"{model} and {reference} have no seed in common on {scene}")
                first, second = ([of[seed] for seed in seeds] for of in (ours, theirs))
                parts.append(paired_difference(first, second, numbers=seeds))
                means.append(np.mean([one.mean for one in second], axis=0))
                names = {"model": model, "reference": reference, "scene": scene}
                compared.append(names | _numbers(parts[-1], means[-1]))
            if len(parts) > 1:
                names = {"model": model, "reference": reference, "scene": MEAN}
                compared.append(names | _numbers(mean_difference(parts), np.mean(means, axis=0)))
    return compared


def _numbers(difference: Difference, reference: np.ndarray) -> Compared:
    """By metric: the reference's own mean, the difference, its intervals and each seed's."""
    return {
        metric: {
            "reference": float(reference[at]),
            "difference": float(difference.mean[at]),
            "of_seeds": [float(value) for value in difference.seeds[:, at]],
            **{name: of and list(of) for name, of in difference.intervals(metric).items()},
        }
        for at, metric in enumerate(difference.metrics)
    }


def _metrics(compared: Sequence[Compared]) -> list[str]:
    return [name for name, value in compared[0].items() if isinstance(value, dict)]


def _text(compared: Sequence[Compared], runs: str, name: str) -> str:
    metrics = _metrics(compared)
    whole = compared[-1]["scene"]  # The mean, or the only test set.
    parts = ["# Models compared", runs]
    for reference in dict.fromkeys(one["reference"] for one in compared):
        mine = [one for one in compared if (one["reference"], one["scene"]) == (reference, whole)]
        head = [f"minus {reference}", *(known_metric(metric).label for metric in metrics)]
        lines = [[one["model"], *(_difference(one[metric]) for metric in metrics)] for one in mine]
        where = "mean over test sets" if whole == MEAN else whole
        parts.append(f"Difference to {reference}, {where}:\n\n{markdown_table(head, lines)}")
    single = [one[metric] for one in compared if one["scene"] != MEAN for metric in metrics]
    parts += [
        f"Of the {len(single)} comparisons on single test sets, {sum(map(_apart, single))} leave "
        f"out 0; by chance alone it would be about {0.05 * len(single):.0f}.",
        INTERVALS,
        f"![Differences and their intervals]({name}.png)",
        f"Differences on each test set are in `{name}.csv`, of each seed in `{name}.json`.",
    ]
    return "\n\n".join(parts) + "\n"


def _apart(one: Mapping[str, Any]) -> bool:
    low, high = one["both"]
    return low > 0 or high < 0


def _difference(one: Mapping[str, Any]) -> str:
    low, high = one["both"]
    text = f"{one['difference']:+.3f} ({low:+.3f} to {high:+.3f})".replace("-", "−")
    return f"**{text}**" if _apart(one) else text


def _csv(compared: Sequence[Compared]) -> str:
    """All differences: a row for a model, test set and metric."""
    head = ["reference", "model", "test_set", "metric", "error_of_reference", "difference"]
    rows = [
        [
            *(one["reference"], one["model"], one["scene"], metric),
            *(one[metric]["reference"], one[metric]["difference"], *one[metric]["both"]),
            len(one[metric]["of_seeds"]),
        ]
        for one in compared
        for metric in _metrics(compared)
    ]
    return csv_text([[*head, "low_95", "high_95", "seeds"], *rows])
