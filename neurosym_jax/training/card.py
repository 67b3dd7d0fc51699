"""The card of a trained model: `README.md` beside its parameters."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.summary import metrics_of
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import replace_card

__all__ = ["model_card", "write_card"]


def model_card(facts: Mapping[str, Any], test_rows: Sequence[Mapping[str, Any]] = ()) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `finish`.
        test_rows: rows of an evaluation of this model on its own test set, and of the baselines.
    """
    return "\n".join(_lines(facts, test_rows)) + "\n"


def write_card(
    folder: Path, facts: Mapping[str, Any], test_rows: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write or replace the card of the model in `folder`, see `model_card`."""
    replace_card(folder, model_card(facts, test_rows))


def _lines(facts: Mapping[str, Any], test_rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    kind = facts["forecaster"]
    network = from_json(FORECASTERS[kind].Config, dict(facts["network"]), "run.json")
    validation = facts["validation"]
    yield f"# {Model(network, {}, kind=kind).name}, {facts['data_name']}"
    yield ""
    yield (
        f"Forecasts {network.pred_len} steps from {network.obs_len} observed ones. "
        "`neurosym_jax.load_model` reads this folder, and `python evaluate.py "
        "--checkpoint` tests it."
    )
    yield from ("", "## Errors", "")
    yield "Best of k forecasts, metres. Joint: the best forecast of the whole scene (SGAN's"
    yield "protocol); marginal: each agent's own best. The two are not comparable."
    chosen = f"{validation['val_ade']:.3f} / {validation['val_fde']:.3f}"
    label = f"validation, which chose step {validation['step']}"
    both = [f"{best}_{error}" for best in ("joint", "marginal") for error in ("ade", "fde")]
    names = [name for name in metrics_of(test_rows[0]) if name not in both] if test_rows else []
    further = {name: known_metric(name) for name in names}
    rows = [[label, str(facts["samples"]), chosen, "", *[""] * len(further)]]
    for row in test_rows:
        errors = [
            f"{row[f'{best}_ade']:.3f} / {row[f'{best}_fde']:.3f}" for best in ("joint", "marginal")
        ]
        errors += [metric.text(row.get(name)) for name, metric in further.items()]
        label = "this model" if row["checkpoint"] else row["model"]
        rows.append([f"test on {row['dataset']}: {label}", str(row["samples"]), *errors])
    head = [
        "",
        "k",
        "joint ADE / FDE",
        "marginal ADE / FDE",
        *(each.title for each in further.values()),
    ]
    yield from ("", markdown_table(head, rows))
    if not test_rows:
        yield from ("", "Not tested yet.")
    if (share := validation.get("val_neighbour_share")) is not None:
        near, move = (validation.get(f"val_neighbour_{name}", 0.0) for name in ("near", "move"))
        yield from ("", "## Neighbours", "")
        yield (
            f"Without their neighbours, the forecasts of {100 * share:.1f} % of people change (of "
            f"{100 * near:.1f} % of those with somebody within 2 m), by {move:.2f} m at the last "
            "step on average, on the validation windows."
        )
    settings = {
        f"{name} windows": f"{count['scenes']} scenes, {count['agents']} agents, "
        f"SHA-256 `{facts['data'][name][:16]}`"
        for name, count in facts["counts"].items()
    }
    settings |= {"parameters": facts["parameters"], "code": facts["code"] or "no checkout"}
    if licences := facts.get("licences"):
        settings["learned from"] = ", ".join(f"{name} ({of})" for name, of in licences.items())
    if plugins := facts.get("plugins"):
        settings["plugins"] = ", ".join(plugins)
    sections = {"training": "", "network": "network: ", "environment": "environment: "}
    for section, prefix in sections.items():
        for name, value in facts[section].items():
            if value not in (None, ""):
                settings[prefix + name] = value
    rows = [[name, str(value)] for name, value in settings.items()]
    yield from ("", "## Training", "", markdown_table(["", ""], rows))
