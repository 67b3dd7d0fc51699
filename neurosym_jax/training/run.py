"""What a training run is: a generator, a recipe and windows; its record, by which it resumes."""

import dataclasses
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.training.recipe import TrainConfig

__all__ = ["Run", "data_digest", "record_of_today", "refuse_other_run"]


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    generator: GeneratorConfig
    recipe: TrainConfig
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The one left out, to be tested on; recorded with the model."""
    data_name: str = "data not named"
    """Of the training data, for people."""

    def describe(self) -> dict[str, Any]:
        """All that must be equal for a run to be resumed; JSON-able."""
        return {
            "generator": to_json(self.generator),
            "training": to_json(self.recipe),
            "scene": self.dataset,
            "data": {
                "training": data_digest(self.training),
                "validation": data_digest(self.validation),
            },
        }


def data_digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def record_of_today(record: dict[str, Any], source: Path) -> dict[str, Any]:
    """A run's record with its configurations as this version writes them, perhaps by an earlier.

    Raises:
        InputError: naming `source`, for what no version wrote.
    """
    kinds = {"generator": GeneratorConfig, "training": TrainConfig}
    today = {
        name: to_json(from_json(kind, record[name], str(source)))
        for name, kind in kinds.items()
        if name in record
    }
    return {**record, **json.loads(json.dumps(today))}


def refuse_other_run(record: dict[str, Any], ours: dict[str, Any], folder: Path) -> None:
    """Refuse to resume the run of `record` as `ours`, where they differ; tell of other machines.

    Args:
        record: of the run in `folder`.
        ours: `Run.describe`, and `environment`.
        folder: for messages.

    Raises:
        InputError: naming what differs.
    """
    ours, record = json.loads(json.dumps(ours)), record_of_today(record, folder)
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
