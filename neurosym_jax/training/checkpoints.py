"""The states of a training run on disk: whole or not at all, verified, the newest and the best.

Arrays are Orbax's; this is its only importer, and imports it when a state is written or read. A
digest of each step's files is ours: Orbax restores some flipped bits without noticing, and a
flipped bit in a shape asks for any amount of memory. Its `Checkpointer` is not used, because a NaN
metric destroys its retention of the best step.
"""

import contextlib
import json
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.runtime.files import folder_digest, new_folder

__all__ = ["TrainingCheckpoints"]

STATE, STEP, DIGEST = "state", "step.json", "sha256"


class TrainingCheckpoints:
    """The steps of one training run under `folder`: the two newest and the best are kept.

    Each step is a folder `step_00000120` of `state/` (Orbax), `step.json` (the caller's record, the
    metric, the leaves' types and shapes) and `sha256`, the digest of the others. It is there whole
    or not at all, whatever kills the process. `save` is durable when it returns. One process at a
    time writes to a folder.
    """

    def __init__(self, folder: Path):
        self._folder = Path(folder)

    def save(self, step: int, state: Any, record: dict[str, Any], metric: float) -> None:
        """Save one step, then remove what is neither among the two newest nor the best.

        Args:
            step: greater than any saved before.
            state: pytree of jax or numpy arrays.
            record: JSON-able.
            metric: lower is better.

        Raises:
            TrainingError: before anything is written, where the metric or a leaf is not finite, the
                record is not JSON or the step is not a new one; and where it cannot be written.
        """
        leaves = {path: np.asarray(leaf) for path, leaf in _by_path(state).items()}
        text = self._text(step, leaves, record, metric)
        try:
            self._clear()
            with new_folder(self._path(step)) as new:
                _write_arrays(new / STATE, list(leaves.values()))
                (new / STEP).write_text(text)
                (new / DIGEST).write_text(folder_digest(new))
            self._prune()
        except Exception as error:  # Orbax and its storage raise many kinds for a full disk.
            reason = f"{self._path(step)}: cannot be written ({_reason(error)})"
            if isinstance(error, InputError):
                reason = str(error)
            raise TrainingError(f"{reason}; what was saved before is kept") from error

    def restore(self, template: Any) -> tuple[int, Any, dict[str, Any]] | None:
        """The newest whole step, as `(step, state, record)`; None where there is none.

        Damaged steps are renamed to `damaged_...`, with a warning on stderr.

        Args:
            template: pytree of arrays (or of their shapes and types) with the state's structure.

        Returns:
            `state` has numpy arrays for leaves, bit for bit those saved.

        Raises:
            TrainingError: where a whole step has other leaves than `template`.
        """
        for step in reversed(self._steps()):
            try:
                leaves, record = self._read(step, template)
            except TrainingError:
                raise
            except Exception as error:  # Orbax and its storage raise many kinds for damaged files.
                self._set_aside(step, error)
            else:
                return step, jax.tree.unflatten(jax.tree.structure(template), leaves), record
        return None

    def _path(self, step: int) -> Path:
        return self._folder / f"step_{step:08d}"

    def _steps(self) -> list[int]:
        names = [path.name.removeprefix("step_") for path in self._folder.glob("step_*")]
        return sorted(int(name) for name in names if name.isdecimal())

    def _text(
        self, step: int, leaves: dict[str, np.ndarray], record: dict[str, Any], metric: float
    ) -> str:
        """The content of `step.json`, or a refusal."""
        saved = self._steps()
        if saved and step <= saved[-1]:
            raise TrainingError(
                f"{self._folder}: step {step} is not after step {saved[-1]}, which is already "
                "there: resume that run, or choose another folder"
            )
        end = f": step {step} is not saved" + (f"; step {saved[-1]} is kept" if saved else "")
        if not math.isfinite(metric):
            raise TrainingError(f"{self._folder}: the metric is {metric}{end}")
        for path, leaf in leaves.items():
            if jnp.issubdtype(leaf.dtype, jnp.inexact) and not np.isfinite(leaf).all():
                raise TrainingError(f"{self._folder}: state{path} is not finite{end}")
        kinds = {path: _kind(leaf) for path, leaf in leaves.items()}
        content = {"metric": float(metric), "leaves": kinds, "record": record}
        try:
            return json.dumps(content, allow_nan=False) + "\n"
        except (TypeError, ValueError) as error:
            raise TrainingError(f"{self._folder}: the record is not JSON ({error}){end}") from None

    def _read(self, step: int, template: Any) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The leaves, in the template's order, and the record."""
        folder = self._path(step)
        if folder_digest(folder, DIGEST) != (folder / DIGEST).read_text():
            raise ValueError("its files do not match their digest")
        content = json.loads((folder / STEP).read_bytes())
        found = content["leaves"]
        wanted = {path: _kind(leaf) for path, leaf in _by_path(template).items()}
        for path in [*wanted, *found]:
            if found.get(path) != wanted.get(path):
                raise TrainingError(
                    f"{folder}: of another configuration: state{path} is "
                    f"{_words(found.get(path))} there and {_words(wanted.get(path))} here"
                )
        leaves = dict(zip(found, _read_arrays(folder / STATE, list(found.values()))))
        return [leaves[path] for path in wanted], content["record"]

    def _prune(self) -> None:
        metrics: dict[int, float] = {}
        for step in self._steps():
            # A step that cannot be read neither counts nor is removed: `restore` reports it.
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                content = json.loads((self._path(step) / STEP).read_bytes())
                metrics[step] = float(content["metric"])
        best = min(metrics, key=lambda step: (metrics[step], -step))
        for step in metrics.keys() - {*sorted(metrics)[-2:], best}:
            # Moved first, so that a kill leaves no half of a step under its name.
            path = self._path(step)
            path.rename(path.with_name(f".{path.name}"))
        self._clear()

    def _clear(self) -> None:
        """Remove what a kill left of steps that were being written or removed."""
        for path in self._folder.glob(".step_*"):
            shutil.rmtree(path)

    def _set_aside(self, step: int, error: Exception) -> None:
        path = self._path(step)
        print(
            f"warning: {path}: step {step} is damaged and passed over: {_reason(error)}",
            file=sys.stderr,
        )
        aside = path.with_name(f"damaged_{path.name}")
        with contextlib.suppress(OSError):  # A folder that cannot be written can still be read.
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)


def _write_arrays(folder: Path, leaves: list[np.ndarray]) -> None:
    from orbax.checkpoint import v1 as ocp

    context = ocp.Context()
    # In the background, Orbax waits twenty minutes for a folder that cannot be made.
    context.asynchronous.create_directories_asynchronously = False
    # By number, because Orbax or the file system may read a leaf's path otherwise. Orbax does not
    # store empty arrays.
    arrays = {f"{number:06d}": leaf for number, leaf in enumerate(leaves) if leaf.size}
    with context:
        ocp.save(str(folder.absolute()), arrays)


def _read_arrays(folder: Path, kinds: list[Any]) -> list[np.ndarray]:
    """The arrays of these (dtype, shape) that `_write_arrays` wrote."""
    from orbax.checkpoint import v1 as ocp

    arrays = ocp.load(str(folder.absolute()))
    return [
        np.zeros(shape, jnp.dtype(dtype)) if 0 in shape else arrays[f"{number:06d}"]
        for number, (dtype, shape) in enumerate(kinds)
    ]


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__


def _by_path(tree: Any) -> dict[str, Any]:
    pairs = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in pairs}


def _kind(leaf: Any) -> list[Any]:
    """Type and shape in their JSON form."""
    leaf = leaf if hasattr(leaf, "dtype") else np.asarray(leaf)
    return [str(leaf.dtype), list(leaf.shape)]


def _words(kind: list[Any] | None) -> str:
    return "absent" if kind is None else f"{kind[0]}{kind[1]}"
