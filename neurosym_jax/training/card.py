"""The card of a trained model: `README.md` beside its parameters."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.data.sources import GENERAL, Synthetic
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.summary import metrics_of
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model

__all__ = ["model_card"]


def model_card(facts: Mapping[str, Any], test_rows: Sequence[Mapping[str, Any]] = ()) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `loop`.
        test_rows: rows of an evaluation of this model on its own test set, and of the baselines.
    """
    return "\n".join(_lines(facts, test_rows)) + "\n"


def _lines(facts: Mapping[str, Any], test_rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    kind, validation = facts["forecaster"], facts["validation"]
    network = from_json(FORECASTERS[kind].Config, dict(facts["network"]), "run.json")
    title = f"# {Model(network, {}, kind=kind).name}"
    if learned := ", ".join(facts["licences"]):
        title += f", trained on {learned}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in facts["licences"]:
        title += f" without {facts['scene']}"
    yield from (title, "")
    yield (
        f"Forecasts {network.pred_len} steps from {network.obs_len} observed ones. "
        "`neurosym_jax.load_model` reads this folder, and `python evaluate.py "
        "--checkpoint` tests it."
    )
    yield from ("", "## Errors", "")
    yield "Best of k forecasts, metres. Joint: the best forecast of the whole scene (SGAN's"
    yield "protocol); marginal: each agent's own best. The two are not comparable."
    names = metrics_of(test_rows[0]) if test_rows else ["joint_ade", "joint_fde"]
    metrics = {name: known_metric(name) for name in names}
    chosen = {
        "joint_ade": validation["val_ade"],
        "joint_fde": validation["val_fde"],
    }
    label = f"validation, which chose step {validation['step']}"
    rows: list[tuple[str, Any, Mapping[str, Any]]] = [(label, facts["samples"], chosen)]
    for row in test_rows:
        model = "this model" if row["checkpoint"] else row["model"]
        rows.append((f"test on {row['dataset']}: {model}", row["samples"], row))
    yield from (
        "",
        markdown_table(
            ["", "k", *(metric.title for metric in metrics.values())],
            [
                [label, str(samples), *(of.text(row.get(name)) for name, of in metrics.items())]
                for label, samples, row in rows
            ],
        ),
    )
    if not test_rows:
        yield from ("", "Not tested yet.")
    if "val_neighbour_near" in validation:
        share, near, move = (validation[f"val_neighbour_{of}"] for of in ("share", "near", "move"))
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
    learned = (f"{name} ({licence})" for name, licence in facts["licences"].items())
    settings |= {"learned from": ", ".join(learned), "plugins": ", ".join(facts["plugins"])}
    sections = {"training": "", "network": "network: ", "environment": "environment: "}
    for section, prefix in sections.items():
        settings |= {f"{prefix}{name}": value for name, value in facts[section].items()}
    known = [[name, str(value)] for name, value in settings.items() if value not in (None, "")]
    yield from ("", "## Training", "", markdown_table(["", ""], known))
