"""How forecasting a stream went, as a table for people."""

import dataclasses
from typing import Any

from neurosym_jax.evaluation.metrics import METRICS, metric_names
from neurosym_robot.online.window import Health

__all__ = ["format_summary"]


def format_summary(summary: dict[str, Any], health: Health) -> str:
    """A table of `Analytics.summary()`, and what was wrong with the stream."""
    counts = dataclasses.asdict(health)
    lines = [f"{counts.pop('frames')} frames, {summary['forecasts']} forecasts; metres"]
    models = {name: means for name, means in summary["models"].items() if means["people"]}
    if models:
        names = [name for name in metric_names() if _is_number(models, name)]
        titles = [METRICS[name].title.rpartition(" ")[::2] for name in names]
        columns = [*titles, ("people", "scored")]
        width = max(map(len, models))
        cells = {
            model: [METRICS[name].text(means[name]) for name in names] + [str(means["people"])]
            for model, means in models.items()
        }
        widths = [
            max(map(len, (*column, *(row[at] for row in cells.values()))))
            for at, column in enumerate(columns)
        ]
        for label, row in [*(("", part) for part in zip(*columns)), *cells.items()]:
            texts = "  ".join(f"{text:>{wide}}" for text, wide in zip(row, widths))
            lines.append(f"  {label:{width}}  {texts}")
    elif summary["forecasts"]:
        lines.append("  nobody whose forecast could be compared with what happened")
    else:
        lines.append("  nobody was seen for a whole observation window")
    latency = summary["latency_ms"]
    if summary["forecasts"]:
        times = ", ".join(f"{name} {value:.2f} ms" for name, value in latency.items())
        lines.append(f"latency from frame to forecast: {times}")
    for text, reasons in (
        ("people without a forecast or a score", summary["dropped"]),
        ("wrong with the stream", counts),
    ):
        shown = [f"{name.replace('_', ' ')} {count}" for name, count in reasons.items() if count]
        if shown:
            lines.append(f"{text}: {', '.join(shown)}")
    return "\n".join(lines)


def _is_number(models: dict[str, dict[str, Any]], metric: str) -> bool:
    """Whether the metric has one value for all steps."""
    return not any(isinstance(means[metric], list) for means in models.values())
