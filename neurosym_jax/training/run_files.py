"""The files of a run: its log, the best state as a model at every moment, and facts at its end.

A run is a folder: `recipe.yaml` (the options that repeat it), `checkpoints/` (to resume
from), `metrics.jsonl`, `model/` (the best state by validation so far, and its card) and
at its end `curves.png` and `run.json`, all facts of the run, whose presence says that
it is finished.
"""

import dataclasses
import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from neurosym_jax.data.recordings import licences_of
from neurosym_jax.data.windows import fingerprint, merged_fingerprints
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import save_model
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.files import append_text, write_json, write_text
from neurosym_jax.runtime.process import code_version
from neurosym_jax.training.run import Run, model_card
from neurosym_jax.training.validation import Row, best_row

__all__ = ["RunFiles"]


class RunFiles:
    """The files of one run in `folder`; `record` is that of the run."""

    def __init__(self, run: Run, folder: Path, record: dict[str, Any]):
        """Write nothing yet."""
        self._run, self._folder, self._record = run, folder, record

    @property
    def finished(self) -> bool:
        """Whether all is written that a finished run leaves."""
        return (self._folder / "run.json").is_file()

    def begin(self, rows: Sequence[Row]) -> None:
        """Write the options and the rows so far."""
        if self._run.options:
            write_text(self._folder / "recipe.yaml", self._run.options)
        write_text(self._folder / "metrics.jsonl", "".join(map(_line, rows)))

    def add(self, row: Row) -> None:
        """Append a row to the log."""
        append_text(self._folder / "metrics.jsonl", _line(row))

    def unfinish(self) -> None:
        """Say that the run goes on."""
        (self._folder / "run.json").unlink(missing_ok=True)

    def keep(self, params: Any, best: Row) -> None:
        """Replace the model by one with these parameters, which `best` was validated with."""
        model = self.model(params, best)
        facts = self._facts(model, best)
        save_model(self._folder / "model", model, model_card(facts), replace=True)

    def finish(self, params: Any, rows: Sequence[Row]) -> Model:
        """Write what a finished run leaves; returns the model."""
        from neurosym_jax.plotting import plot_training, save_figure

        model = self.model(params, best_row(rows))
        if self.finished:
            return model
        self.keep(params, best_row(rows))

        def curves(*metrics: str) -> dict[str, Any]:
            pairs = {
                name: [(r["step"], r[name]) for r in rows if name in r]
                for name in metrics
            }
            return {
                name: tuple(zip(*points)) for name, points in pairs.items() if points
            }

        losses = curves("loss", "g_loss", "g_adversarial", "d_loss")
        errors = curves("val_ade", "val_fde", "val_energy_score")
        figure = plot_training(losses, errors, "training", best=best_row(rows)["step"])
        save_figure(figure, self._folder / "curves.png")
        # Last: it says that the run is finished, whatever kills the process.
        write_json(self._folder / "run.json", self._facts(model, best_row(rows)))
        return model

    def model(self, params: Any, best: Row) -> Model:
        """The model with these parameters, and its origin, that of the initial model included."""
        run, init, data = self._run, self._run.init, licences_of(self._run.data)
        if init is not None:
            data = {**(init.data or {"the initial model's": "unstated"}), **data}
        return Model(
            run.config,
            params,
            run.dataset,
            run.forecaster.key,
            seed=run.recipe.seed,
            neighbours=best.get("val_neighbour_near"),
            seen=self._seen,
            plugins=names(loaded()),
            data=data,
            step=best["step"],
        )

    @functools.cached_property
    def _seen(self) -> str:
        before = () if self._run.init is None else (self._run.init.seen,)
        return merged_fingerprints(fingerprint(self._run.training), *before)

    @functools.cached_property
    def _code(self) -> str | None:
        return code_version()

    def _facts(self, model: Model, best: Row) -> dict[str, Any]:
        """The content of `run.json`."""
        parts = {"training": self._run.training, "validation": self._run.validation}
        return {
            **self._record,
            "samples": self._run.samples,
            "licences": model.data,
            "counts": {
                name: {"scenes": w.scenes, "agents": w.agents}
                for name, w in parts.items()
            },
            "recordings": {
                name: [dataclasses.asdict(reading) for reading in w.reading]
                for name, w in parts.items()
            },
            "parameters": sum(leaf.size for leaf in jax.tree.leaves(model.params)),
            "code": self._code,
            "plugins": list(model.plugins),
            "validation": best,
        }


def _line(row: Row) -> str:
    return json.dumps(row, allow_nan=False) + "\n"
