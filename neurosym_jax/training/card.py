"""The card of a trained model: `README.md` beside its parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.data.sources import GENERAL, Synthetic
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model

__all__ = ["model_card"]

CARD = """\
# {title}

Forecasts {pred_len} steps from {obs_len} observed ones. `neurosym_jax.load_model` reads this folder, and `python evaluate.py --checkpoint` tests it.

## Errors

Best of k forecasts, metres. Joint: the best forecast of the whole scene (SGAN's protocol); marginal: each agent's own best. The two are not comparable.

Validation chose step {step}: joint ADE {val_ade:.3f}, FDE {val_fde:.3f}, best of {samples}.

{tests}

## Training

{settings}
"""  # noqa: E501


def model_card(facts: Mapping[str, Any], test_rows: Sequence[dict[str, Any]] = ()) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `loop`.
        test_rows: rows of an evaluation of this model on its own test set, and of the baselines.
    """
    kind, licences = facts["forecaster"], facts["licences"]
    network = from_json(FORECASTERS[kind].Config, dict(facts["network"]), "run.json")
    title = Model(network, {}, kind=kind).name
    if licences:
        title += f", trained on {', '.join(licences)}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in licences:
        title += f" without {facts['scene']}"
    settings = {
        f"{name} windows": f"{count['scenes']} scenes, {count['agents']} agents, "
        f"SHA-256 `{facts['data'][name][:16]}`"
        for name, count in facts["counts"].items()
    }
    settings["learned from"] = ", ".join(f"{name} ({of})" for name, of in licences.items())
    settings |= {name: facts[name] for name in ("parameters", "code")}
    settings["plugins"] = ", ".join(facts["plugins"])
    if (share := facts["validation"].get("val_neighbour_share")) is not None:
        settings["people whom their neighbours change"] = f"{100 * share:.1f} %, in validation"
    for section, prefix in (("training", ""), ("network", "network: "), ("environment", "")):
        settings |= {f"{prefix}{name}": value for name, value in facts[section].items()}
    known = [[name, str(value)] for name, value in settings.items() if value not in (None, "")]
    return CARD.format(
        title=title,
        obs_len=network.obs_len,
        pred_len=network.pred_len,
        samples=facts["samples"],
        **{name: facts["validation"][name] for name in ("step", "val_ade", "val_fde")},
        tests=format_table(rows_frame(test_rows), "markdown") if test_rows else "Not tested yet.",
        settings=markdown_table(["", ""], known),
    )
