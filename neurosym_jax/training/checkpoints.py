"""The states of a training run on disk: whole or not at all, verified, the newest and the best."""

import contextlib
import hashlib
import json
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.configuration import FORMAT
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.runtime.files import new_folder
from neurosym_jax.training.arrays import digest, read_arrays, write_arrays

__all__ = ["TrainingCheckpoints"]

STEP = "step.json"


class TrainingCheckpoints:
    """The steps of one training run under `folder`: the two newest and the best are kept.

    Each step is a folder `step_00000120` of `state/` (Orbax) and `step.json` (the caller's record,
    the metric, and digests), which is there whole or not at all, whatever kills the process.
    Orbax's own `training.Checkpointer` is not used: it saves behind one's back, forgets the best
    after a NaN metric, restores some flipped bits silently and calls a truncated file a wrong
    handler.
    `save` is durable when it returns. One process at a time writes to a folder.
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
        content = self._content(step, leaves, record, metric)
        try:
            self._write(step, leaves, content)
        except Exception as error:  # Orbax and its storage raise many kinds for a full disk
            reason = f"{self._path(step)}: cannot be written ({_reason(error)})"
            if isinstance(error, InputError):
                reason = str(error)
            raise TrainingError(f"{reason}; what was saved before is kept") from error

    def _write(self, step: int, leaves: dict[str, np.ndarray], content: dict[str, Any]) -> None:
        self._clear()
        # By number: a leaf's path may hold what Orbax or the file system reads otherwise.
        arrays = {f"{i:06d}": leaf for i, leaf in enumerate(leaves.values()) if leaf.size}
        with new_folder(self._path(step)) as new:
            write_arrays(new / "state", arrays)
            files = sorted(path for path in new.rglob("*") if path.is_file())
            digests = {path.relative_to(new).as_posix(): _file_digest(path) for path in files}
            content["files"] = digests
            text = json.dumps({"sha256": _json_digest(content), "content": content})
            (new / STEP).write_text(text + "\n")
        self._prune()

    def restore(self, template: Any) -> tuple[int, Any, dict[str, Any]] | None:
        """The newest whole step, as `(step, state, record)`; None where none is.

        Damaged steps are set aside under another name, with a line on stderr.

        Args:
            template: pytree of arrays (or of their shapes and types) with the state's structure.

        Returns:
            `state` has numpy arrays for leaves, bit for bit those saved.

        Raises:
            TrainingError: where a whole step has other leaves than `template`, or another format.
        """
        for step in reversed(self._steps()):
            try:
                leaves, record = self._read(step, template)
            except TrainingError:
                raise
            except Exception as error:  # Orbax and its storage raise many kinds for damaged files
                self._set_aside(step, error)
            else:
                return step, jax.tree.unflatten(jax.tree.structure(template), leaves), record
        return None

    def _path(self, step: int) -> Path:
        return self._folder / f"step_{step:08d}"

    def _steps(self) -> list[int]:
        names = [path.name.removeprefix("step_") for path in self._folder.glob("step_*")]
        return sorted(int(name) for name in names if name.isdecimal())

    def _content(
        self, step: int, leaves: dict[str, np.ndarray], record: dict[str, Any], metric: float
    ) -> dict[str, Any]:
        """What `step.json` says of a step, or a refusal."""
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
        content = {
            "format": FORMAT,
            "step": int(step),
            "metric": float(metric),
            "leaves": {path: _kind(leaf) for path, leaf in leaves.items()},
            "sha256": digest(leaves),
            "record": record,
        }
        try:  # As it will be read: JSON turns numbers for keys into text.
            return json.loads(json.dumps(content, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise TrainingError(f"{self._folder}: the record is not JSON ({error}){end}") from None

    def _verified(self, step: int) -> dict[str, Any]:
        """What `step.json` says of a step whose files are those that were saved.

        Before Orbax sees them: a flipped bit in a shape asks for any memory.
        """
        folder = self._path(step)
        data = _read_json(folder / STEP)
        content = data["content"]
        if data["sha256"] != _json_digest(content) or content["step"] != step:
            raise ValueError(f"{STEP} does not match its digest")
        if content["format"] != FORMAT:
            raise TrainingError(f"{folder}: format {content['format']!r} is not {FORMAT}, ours")
        for name, sha in content["files"].items():
            if not (folder / name).is_file():
                raise ValueError(f"{name} is missing")
            if _file_digest(folder / name) != sha:
                raise ValueError(f"{name} does not match its digest")
        return content

    def _read(self, step: int, template: Any) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The leaves, in the template's order, and the record."""
        folder, content = self._path(step), self._verified(step)
        kinds = content["leaves"]
        wanted = {path: _kind(leaf) for path, leaf in _by_path(template).items()}
        for path in [*wanted, *kinds]:
            if kinds.get(path) != wanted.get(path):
                raise TrainingError(
                    f"{folder}: of another configuration: state{path} is "
                    f"{_words(kinds.get(path))} there and {_words(wanted.get(path))} here"
                )
        arrays = read_arrays(folder / "state")
        leaves: dict[str, np.ndarray] = {}
        for i, (path, (dtype, shape)) in enumerate(kinds.items()):
            # Orbax does not store arrays without elements.
            empty = 0 in shape
            leaves[path] = np.zeros(shape, jnp.dtype(dtype)) if empty else arrays[f"{i:06d}"]
        if digest(leaves) != content["sha256"]:
            raise ValueError("the leaves do not match their digest")
        return [leaves[path] for path in wanted], content["record"]

    def _metrics(self) -> dict[int, float]:
        """The metrics of the steps that can be read."""
        metrics: dict[int, float] = {}
        for step in self._steps():
            # A step that cannot be read neither counts nor is removed: `restore` tells of it.
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                metrics[step] = float(_read_json(self._path(step) / STEP)["content"]["metric"])
        return metrics

    def _prune(self) -> None:
        metrics = self._metrics()
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


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except ValueError:
        raise ValueError(f"{path.name} is not JSON") from None


def _json_digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
