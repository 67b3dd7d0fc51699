"""A training run: what is trained on what, its first state, record to resume it by, and card.

Everything random follows from (seed, step).
"""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.data.sources import GENERAL, Synthetic
from neurosym_jax.data.windows import Windows
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.forecaster import FORECASTERS, Forecaster, forecaster_of
from neurosym_jax.runtime.process import COMPILED_QUICKLY, run_environment
from neurosym_jax.training.catalogue import refuse_other_recipe
from neurosym_jax.training.state import TrainState

__all__ = ["ROUND", "Run", "model_card", "record_of"]

ROUND = 25
"""Most steps between two updates of the progress bar."""

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
"""The text of `README.md` beside the parameters."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    config: Any
    """The configuration of what is trained."""
    recipe: Any
    """A `Recipe` that fits it."""
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The data set that was left out, to be tested on; recorded with the model."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from."""
    options: str = ""
    """The file of options that repeats it, in YAML; empty where no command made it."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network."""
        refuse_other_recipe(self.forecaster, self.recipe)

    @property
    def forecaster(self) -> Forecaster:
        """What is trained."""
        return forecaster_of(self.config)

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.forecaster.best_of(self.recipe)

    def init_state(self) -> TrainState:
        """The state before training."""
        init = functools.partial(self.forecaster.init_state, self.recipe)
        return jax.jit(init, compiler_options=COMPILED_QUICKLY)(self._key(0))

    def rounds(self) -> Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]:
        """See `Forecaster.rounds`."""
        return self.forecaster.rounds(self.training, self.recipe, self._key(1))

    def _key(self, part: int) -> Array:
        return jax.random.fold_in(jax.random.key(self.recipe.seed), part)


def record_of(run: Run) -> dict[str, Any]:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    return {
        "forecaster": run.forecaster.key,
        "config": to_json(run.config),
        "training": to_json(run.recipe),
        "scene": run.dataset,
        "data": {"training": _digest(run.training), "validation": _digest(run.validation)},
        "environment": run_environment(),
    }


def _digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def model_card(facts: Mapping[str, Any], test_rows: Sequence[dict[str, Any]] = ()) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `loop`.
        test_rows: rows of an evaluation of this model on its own test set, and of the baselines.
    """
    family, licences = FORECASTERS[facts["forecaster"]], facts["licences"]
    config = from_json(family.Config, dict(facts["config"]), "run.json")
    title = family(config).title
    if licences:
        title += f", trained on {', '.join(licences)}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in licences:
        title += f" without {facts['scene']}"
    settings = {
        f"{name} windows": f"{count['scenes']} scenes, {count['agents']} agents, "
        f"SHA-256 `{facts['data'][name][:16]}`"
        for name, count in facts["counts"].items()
    }
    settings["learned from"] = ", ".join(
        f"{name} ({licence})" for name, licence in licences.items()
    )
    settings |= {name: facts[name] for name in ("parameters", "code")}
    settings["plugins"] = ", ".join(facts["plugins"])
    if (share := facts["validation"].get("val_neighbour_share")) is not None:
        settings["people whom their neighbours change"] = f"{100 * share:.1f} %, in validation"
    for section, prefix in (("training", ""), ("config", "config: "), ("environment", "")):
        settings |= {f"{prefix}{name}": value for name, value in facts[section].items()}
    lines = [[name, str(value)] for name, value in settings.items() if value not in (None, "")]
    return CARD.format(
        title=title,
        obs_len=config.obs_len,
        pred_len=config.pred_len,
        samples=facts["samples"],
        **{name: facts["validation"][name] for name in ("step", "val_ade", "val_fde")},
        tests=format_table(rows_frame(test_rows), "markdown") if test_rows else "Not tested yet.",
        settings=markdown_table(["", ""], lines),
    )
