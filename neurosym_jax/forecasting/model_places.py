"""Where models are: what a path or a name means, which models ship, and which are at hand."""

import os
from collections.abc import Sequence
from pathlib import Path

import neurosym_jax
from neurosym_jax.data.published import data_folder, find
from neurosym_jax.errors import InputError

__all__ = ["find_checkpoints", "find_model", "models_at_hand", "shipped_models"]

DOWNLOADED = {
    "sgan-20v": Path("sgan-checkpoints/sgan-models"),
    "sgan-20vp": Path("sgan-checkpoints/sgan-p-models"),
}
"""SGAN's published checkpoints, without pooling and with it: folders in the data folder."""


def find_model(path: Path | str) -> Path:
    """A model's folder or file by its path, the name of one that ships, or a path of downloads.

    A path that is there goes before a name. What is nowhere is returned as it is.
    """
    path = Path(path)
    shipped = _shipped_folder() / path
    # Of `os`, for which a name that is too long is nowhere.
    if path.name and not os.path.exists(path) and os.path.isdir(shipped):
        return shipped
    return find(path)


def find_checkpoints(names: Sequence[Path | str]) -> list[str]:
    """`names` for `load_model`, with all the checkpoints in a folder in place of that folder.

    Args:
        names: see `find_model`; also `sgan-20v` and `sgan-20vp`, once they are downloaded.

    Raises:
        InputError: for checkpoints that are not downloaded yet.
    """
    return [path for name in names for path in _several(str(name))]


def _several(name: str) -> list[str]:
    folder = find_model(name)
    if name in DOWNLOADED and not os.path.exists(folder):
        folder = data_folder() / DOWNLOADED[name]
        if not folder.is_dir():
            raise InputError(
                f"{name}: not here yet: `neurosym download sgan-checkpoints` fetches it"
            )
    return [str(path) for path in _in_folder(folder)] or [name]


def _in_folder(folder: Path) -> list[Path]:
    """The models in a folder that is none itself."""
    if not os.path.isdir(folder) or (folder / "config.json").exists():
        return []
    return sorted([*folder.glob("*.pt"), *(path.parent for path in folder.glob("*/config.json"))])


def shipped_models() -> list[Path]:
    """The folders of the models that ship with the package, in order of name."""
    return _in_folder(_shipped_folder())


def models_at_hand() -> list[tuple[str, Path]]:
    """(name, place) of the models that can be named without a path: shipped, then downloaded."""
    shipped = [(path.name, path) for path in shipped_models()]
    base = data_folder() / "sgan-checkpoints"
    folders = [base / folder.name for folder in DOWNLOADED.values()]
    downloaded = [path for folder in folders for path in _in_folder(folder)]
    return shipped + [(path.relative_to(base).as_posix(), path) for path in downloaded]


def _shipped_folder() -> Path:
    """`checkpoints`, within the package where that is installed, beside it in a clone."""
    package = Path(neurosym_jax.__path__[0])
    within = package / "checkpoints"
    return within if within.is_dir() else package.parent / "checkpoints"
