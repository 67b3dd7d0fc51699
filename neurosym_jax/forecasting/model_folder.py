"""Models on disk: our folders and, read through `interop`, torch's files.

A model's folder holds `config.json` (format version, generator, scene left out of training, digest
of the parameters), `params/` (arrays, see `checkpoint`) and a card for people.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from neurosym_jax.config import FORMAT, GeneratorConfig, from_json
from neurosym_jax.data.published import find
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.models import Generator
from neurosym_jax.models.pooling import POOLINGS
from neurosym_jax.runtime.processes import is_first
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.arrays import digest, read_arrays, write_arrays

__all__ = ["load_model", "save_model", "shipped_models"]

CONFIG = "config.json"


def save_model(folder: Path | str, model: Model) -> None:
    """Write `model` as a new folder; of several processes all call it, and the first one writes.

    Raises:
        InputError: when something is already there.
    """
    folder = Path(folder)
    params = jax.tree.map(np.asarray, model.params)
    if is_first():
        if folder.exists():
            raise InputError(f"{folder}: already there, and nothing is overwritten")
        folder.mkdir(parents=True)
    write_arrays(folder / "params", params)
    if not is_first():
        return
    config = {
        "format": FORMAT,
        "generator": dataclasses.asdict(model.config),
        "scene": model.dataset,
        "sha256": digest(params),
    }
    # Last, so that a folder with a config is whole.
    (folder / CONFIG).write_text(json.dumps(config, indent=2) + "\n")


def load_model(path: Path | str) -> Model:
    """Read a model's folder, or a torch checkpoint file of SGAN, also one that was downloaded.

    Raises:
        InputError: for anything that is not such a thing, is damaged, or has another format.
    """
    path = find(Path(path))
    if path.is_file():
        from neurosym_jax.interop.torch import load_torch_checkpoint

        checkpoint = load_torch_checkpoint(path)
        return Model(checkpoint.config, {"params": checkpoint.params}, checkpoint.scene)
    if not path.exists():
        raise InputError(f"{path}: no such checkpoint")
    if not (path / CONFIG).is_file():
        raise InputError(f"{path}: not a model's folder: it has no {CONFIG}")
    source = str(path / CONFIG)
    try:
        data = json.loads((path / CONFIG).read_text())
        fields = {"format", "generator", "scene", "sha256"}
        if not isinstance(data, dict) or set(data) != fields:
            raise InputError(f"{source}: must have exactly the fields {', '.join(sorted(fields))}")
        generator = {"format": data["format"], **data["generator"]}
    except (json.JSONDecodeError, UnicodeDecodeError, TypeError) as error:
        raise InputError(f"{source}: not a model's configuration ({error})") from None
    config = from_json(GeneratorConfig, generator, source)
    params = read_arrays(path / "params")
    if digest(params) != data["sha256"]:
        raise InputError(f"{path}: damaged: the parameters do not match the digest in {CONFIG}")
    _refuse_misshapen(config, params, source)
    return Model(config, params, data["scene"])


def _refuse_misshapen(config: GeneratorConfig, params: Any, source: str) -> None:
    """The digest is of the parameters alone, so `config.json` may describe another network."""
    example = make_scene(np.zeros((1, config.obs_len, 2)))
    noise = np.zeros((1, config.noise_dim))
    pairs = (1, 1) if POOLINGS[config.pooling].of_pairs else (1,)
    alpha = np.zeros((*pairs, config.obs_len))
    wanted: Any = jax.eval_shape(Generator(config).init, jax.random.key(0), example, noise, alpha)
    if parameters := initial_parameters(config.weighting):
        wanted = {**wanted, "weighting": parameters}
    wanted, given = (
        {jax.tree_util.keystr(at): np.shape(leaf) for at, leaf in leaves}
        for leaves in map(jax.tree_util.tree_leaves_with_path, (wanted, params))
    )
    for name in [*wanted, *given]:
        if wanted.get(name) != given.get(name):
            shapes = [tree.get(name, "absent") for tree in (given, wanted)]
            raise InputError(
                f"{source}: describes another network: {name} is {shapes[0]}, not {shapes[1]}"
            )


def shipped_models(folder: Path) -> list[Path]:
    """The models' folders under `folder`, in order of name; none where it does not exist."""
    return sorted(path.parent for path in folder.glob(f"*/{CONFIG}"))
