"""How forecasting a stream went, as a table for people."""

import dataclasses
from typing import Any

from neurosym_jax.online.window import Health

__all__ = ["format_summary"]


def format_summary(summary: dict[str, Any], health: Health) -> str:
    """A table of `Analytics.summary()`, and what was wrong with the stream."""
    counts = dataclasses.asdict(health)
    lines = [f"{counts.pop('frames')} frames, {summary['forecasts']} forecasts; metres"]
    models = {name: means for name, means in summary["models"].items() if means["people"]}
    if models:
        width = max(map(len, models))
        lines += [
            f"  {'':{width}}     joint best      marginal best   people",
            f"  {'':{width}}     ADE     FDE     ADE     FDE     scored",
        ]
        keys = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
        for name, means in models.items():
            errors = "".join(f"  {means[key]:6.3f}" for key in keys)
            lines.append(f"  {name:{width}} {errors} {means['people']:9}")
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
