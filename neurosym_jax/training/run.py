"""A training run: a generator, a recipe and windows; and the record by which it is resumed."""

import dataclasses
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import to_json
from neurosym_jax.data.licences import licences_of
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.training.recipe import RECIPES, AnchorRecipe, TrainConfig

__all__ = ["KINDS", "Run", "data_digest", "refuse_other_run"]

KINDS = {"generator": TrainConfig, "anchors": AnchorRecipe, "anchor_table": AnchorRecipe}
"""The type of recipe for each forecaster that can be trained."""


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
    data_name: str = "data not named"
    """Name of the training data, for people."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from, for their licences."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network."""
        if not isinstance(self.recipe, wanted := KINDS[self.kind]):
            names = ", ".join(name for name, of in RECIPES.items() if isinstance(of, wanted))
            raise InputError(f"the recipe is not one of {self.kind}: --recipe {names}")

    @property
    def kind(self) -> str:
        """The name of the forecaster that is trained."""
        return next(kind for kind in KINDS if FORECASTERS[kind].Config is type(self.network))

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.recipe.samples(self.network)

    def describe(self) -> dict[str, Any]:
        """The facts that must be equal for a run to be resumed; JSON-able."""
        return {
            "forecaster": self.kind,
            "network": to_json(self.network),
            "training": to_json(self.recipe),
            "scene": self.dataset,
            "data": {name: data_digest(windows) for name, windows in self._windows().items()},
        }

    def data_facts(self) -> dict[str, Any]:
        """Further facts of the data; JSON-able."""
        parts = self._windows().items()
        return {
            "data_name": self.data_name,
            "licences": licences_of(self.data),
            "samples": self.samples,
            "counts": {name: {"scenes": w.scenes, "agents": w.agents} for name, w in parts},
            "recordings": {name: [how.to_json() for how in w.reading] for name, w in parts},
        }

    def _windows(self) -> dict[str, Windows]:
        return {"training": self.training, "validation": self.validation}


def data_digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def refuse_other_run(record: dict[str, Any], ours: dict[str, Any], folder: Path) -> None:
    """Refuse to resume the run of `record` as `ours` if they differ; warn of another environment.

    Args:
        record: of the run in `folder`.
        ours: `Run.describe`, and `environment`.
        folder: for messages.

    Raises:
        InputError: naming the part that differs.
    """
    ours = json.loads(json.dumps(ours))
    for name, value in ours.items():
        if name != "environment" and record.get(name) != value:
            raise InputError(f"{folder}: holds another run: its {name} differs")
    for name, value in ours["environment"].items():
        if (before := record["environment"].get(name)) != value:
            print(
                f"warning: {folder}: the run began with {name} {before} and goes on with {value}: "
                "it will not end with the same bits",
                file=sys.stderr,
            )
