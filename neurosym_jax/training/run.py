"""A training run: what is trained on what, and the record by which it is resumed."""

import dataclasses
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import to_json
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.runtime.environment import run_environment
from neurosym_jax.training.recipe import RECIPES, AnchorRecipe, TrainConfig

__all__ = ["Run", "record_of", "refuse_other_run"]


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    network: Any
    """The configuration of a generator, an anchors network or an anchor table."""
    recipe: Any
    """A `Recipe` for it."""
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The data set that was left out, to be tested on; recorded with the model."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network."""
        wanted = TrainConfig if isinstance(self.network, GeneratorConfig) else AnchorRecipe
        if not isinstance(self.recipe, wanted):
            fits = ", ".join(name for name, of in RECIPES.items() if isinstance(of, wanted))
            raise InputError(f"the recipe is not one of {self.kind}: --recipe {fits}")

    @property
    def kind(self) -> str:
        """The name of the forecaster that is trained."""
        return next(kind for kind, of in FORECASTERS.items() if of.Config is type(self.network))

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.recipe.best_k if self.kind == "generator" else self.network.samples


def record_of(run: Run) -> dict[str, Any]:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    return {
        "forecaster": run.kind,
        "network": to_json(run.network),
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


def refuse_other_run(record: dict[str, Any], ours: dict[str, Any], folder: Path) -> None:
    """Refuse to resume the run of `record` as `ours` if they differ; warn of another environment.

    Raises:
        InputError: naming the part that differs.
    """
    ours = json.loads(json.dumps(ours))
    for name, value in ours.items():
        if name != "environment" and record[name] != value:
            raise InputError(f"{folder}: holds another run: its {name} differs")
    for name, now in ours["environment"].items():
        if (before := record["environment"].get(name)) != now:
            text = f"the run began with {name} {before} and goes on with {now}: other bits"
            print(f"warning: {folder}: {text}", file=sys.stderr)
