"""Rows of an evaluation's report."""


def result_row(model, dataset, means, checkpoint=None, half=0.01, p=None, **facts):
    """A row with these means by metric, each with an interval of +- `half`, or without one, and
    `p`, of the first metric's test against the best."""
    row = {
        "checkpoint": checkpoint,
        "model": model,
        "dataset": dataset,
        "obs_len": 8,
        "pred_len": 8,
    }
    row |= {"samples": 20, "seeds": 1, "scenes": 602, "agents": 2253, "blocks": 50}
    row |= {"latency": 0.001, "forecasts_per_second": 1000.0}
    for name, mean in means.items():
        ends = (None, None) if None in (mean, half) else (mean - half, mean + half)
        columns = (name, f"{name}_low", f"{name}_high", f"{name}_std", f"{name}_p")
        row |= dict(zip(columns, (mean, *ends, None, p)))
        p = None
    return row | facts
