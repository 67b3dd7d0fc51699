"""Where models are: what a name means, which models ship, and which were downloaded."""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import neurosym_jax
from neurosym_jax.data.recordings import GENERAL, SCENES, data_folder, find
from neurosym_jax.errors import InputError, InputWarning

__all__ = [
    "DOWNLOADED",
    "RECOMMENDED",
    "find_checkpoints",
    "find_model",
    "models_at_hand",
]
__all__ += ["shipped_models", "shipped_name", "state_of_run"]

RECOMMENDED = "recommended"
"""Name of the model to use: `anchors`, trained without the data set that is asked for."""

DOWNLOADED = {
    "sgan-20v": Path("sgan-checkpoints/sgan-models"),
    "sgan-20vp": Path("sgan-checkpoints/sgan-p-models"),
}
"""SGAN's published checkpoints, without pooling and with it: folders in the data folder."""


def shipped_name(model: str, dataset: str | None, pred_len: int) -> str:
    """The shipped model that has not learned from `dataset`: `anchors_zara1_12`, or `general`."""
    return f"{model}_{dataset if dataset in SCENES else GENERAL}_{pred_len}"


def find_model(
    path: Path | str, dataset: str | None = None, pred_len: int | None = None
) -> Path:
    """The place of a model: a path with models, the name of a shipped model, or a downloaded path.

    The folder of a training stands for its model. A path that is found nowhere is
    returned unchanged. `recommended` is the shipped `anchors` for `dataset` and
    `pred_len` (default: 8).

    Warns:
        InputWarning: for a path that has the name of a shipped model.
    """
    path, name = Path(path), Path(path)
    if str(path) == RECOMMENDED:
        name = Path(shipped_name("anchors", dataset, pred_len or 8))
    shipped = _shipped_folder() / name
    # os.path, unlike Path, takes a name that is too long for one that does not exist.
    if not name.name or not os.path.isdir(shipped):
        return _model_of_run(find(path if os.path.exists(path) else name))
    if not _holds_models(path):
        return shipped
    if not os.path.samefile(path, shipped):
        line = f"{path}: the one in this folder, not the model of this name that ships"
        warnings.warn(line, InputWarning, stacklevel=2)
    return _model_of_run(path)


def _model_of_run(path: Path) -> Path:
    """The model in the folder of a training; another path unchanged."""
    is_run = not os.path.exists(path / "config.json") and os.path.isdir(path / "model")
    return path / "model" if is_run else path


def state_of_run(path: str, step: int) -> str:
    """What state a model is that was kept after `step` steps of a training, in words."""
    run = find_model(path).parent
    ends = (run / "checkpoints").is_dir() and not (run / "run.json").exists()
    unfinished = ", which is not finished" if ends else ""
    return f"{path}: the state after {step} steps of its training{unfinished}"


def find_checkpoints(
    names: Sequence[Path | str],
    datasets: Sequence[str | None] = (None,),
    pred_len: int | None = None,
) -> list[str]:
    """`names` for `load_model`; a folder of checkpoints is replaced by all of them.

    `sgan-20v` and `sgan-20vp` are the downloaded checkpoints of SGAN; `recommended`
    stands for the model of each of `datasets` and `pred_len`, see `find_model`.

    Raises:
        InputError: for checkpoints that are not downloaded yet.
    """
    paths: list[str] = []
    for name in map(str, names):
        if name == RECOMMENDED and not _holds_models(Path(name)):
            paths += dict.fromkeys(
                find_model(name, dataset, pred_len).name for dataset in datasets
            )
            continue
        folder = find_model(name)
        if name in DOWNLOADED and not os.path.exists(folder):
            folder = data_folder() / DOWNLOADED[name]
            if not folder.is_dir():
                raise InputError(
                    f"{name}: not here yet: `neurosym download sgan-checkpoints` fetches it"
                )
        paths += [str(path) for path in _models_in(folder)] or [name]
    return paths


def shipped_models() -> list[Path]:
    """The folders of the models that ship with the package, in order of name."""
    return _models_in(_shipped_folder())


def models_at_hand() -> list[tuple[str, Path]]:
    """(name, place) of the models that have a name: shipped, then downloaded."""
    places = [(path.name, path) for path in shipped_models()]
    for folder in DOWNLOADED.values():
        paths = _models_in(data_folder() / folder)
        places += [(f"{folder.name}/{path.name}", path) for path in paths]
    return places


def _holds_models(path: Path) -> bool:
    """Whether a path is a model, or a folder of models."""
    return (
        os.path.isfile(path)
        or os.path.isfile(path / "config.json")
        or bool(_models_in(path))
    )


def _models_in(folder: Path) -> list[Path]:
    """The models in a folder that is not a model itself."""
    if not os.path.isdir(folder) or (folder / "config.json").exists():
        return []
    return sorted(
        [*folder.glob("*.pt"), *(path.parent for path in folder.glob("*/config.json"))]
    )


def _shipped_folder() -> Path:
    """`checkpoints`: in the package where that is installed, beside it in a clone."""
    package = Path(neurosym_jax.__path__[0])
    within = package / "checkpoints"
    return within if within.is_dir() else package.parent / "checkpoints"
