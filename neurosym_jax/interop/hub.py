"""Models on the Hugging Face Hub: download and upload of model folders."""

import contextlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError, optional_module, printable
from neurosym_jax.models.disk import FILES, find_model, load_model, save_model
from neurosym_jax.models.forecast import Model

__all__ = ["from_pretrained", "push_to_hub"]


def from_pretrained(name: Path | str, *, revision: str | None = None) -> Model:
    """The model of a path or shipped name, as `load_model`, else of the Hub's `owner/name`.

    `revision` is a branch, tag or commit of the Hub's repository; default: its main
    branch.

    Raises:
        InputError: where nothing is found, huggingface_hub is absent, or as
            `load_model`.
    """
    if find_model(name).exists() or not re.fullmatch(r"[\w.-]+/[\w.-]+", str(name)):
        return load_model(name)
    with _hub(str(name)) as hub:
        folder = hub.snapshot_download(
            str(name), revision=revision, allow_patterns=[*FILES]
        )
    return load_model(folder)


def push_to_hub(
    model: Model, name: str, *, private: bool = False, card: str | None = None
) -> str:
    """Upload to the Hub's `owner/name`, which is made if need be; returns the commit's URL.

    With `private` the repository is made so that only its owner sees it, and one that
    is public already is refused.

    Raises:
        InputError: where huggingface_hub is absent or the Hub refuses, and as
            `save_model`.
    """
    with tempfile.TemporaryDirectory() as place, _hub(name) as hub:
        save_model(Path(place) / "model", model, card)
        hub.create_repo(name, private=private, exist_ok=True)
        # What is there already keeps its visibility.
        if private and not hub.model_info(name).private:
            raise InputError(f"{name}: is there already and public: nothing is sent")
        return hub.upload_folder(
            repo_id=name, folder_path=Path(place) / "model"
        ).commit_url


@contextlib.contextmanager
def _hub(name: str) -> Iterator[Any]:
    """The module huggingface_hub, whose errors become one line that names the repository."""
    hub = optional_module("huggingface_hub", f"{name}: the Hub", "hub")
    try:
        yield hub
    except InputError:
        raise
    except Exception as error:
        # An error of httpx, of huggingface_hub or of the system, by version of these.
        raise InputError(f"{name}: {printable(str(error))[:300]}") from None
