"""Models on disk: folders of three files and, read through `interop`, torch's checkpoints.

A model's folder holds `config.json` (the kind of forecaster and its configuration, the dataset left
out of training, a digest, and, where it was trained with plugins, their names, which are told but
never imported), `params.safetensors` (arrays by path, see `parameters`) and `README.md`, the card
for people. The digest is of both other files' bytes and stands in the second line:

    (tail -n +3 config.json; cat params.safetensors) | sha256sum

It is compared before either file is parsed.
"""

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax import configuration
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_places import find_model
from neurosym_jax.forecasting.parameters import (
    flat_parameters,
    listed,
    nested_parameters,
    refuse_not_finite,
)
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.files import new_folder
from neurosym_jax.runtime.memory import refuse_beyond_memory

__all__ = [
    "CARD",
    "FORMAT",
    "load_model",
    "refuse_misfit",
    "save_model",
]

CONFIG, PARAMS, CARD = "config.json", "params.safetensors", "README.md"
FORMAT = 2
FIELDS = ("format", "forecaster", "config", "dataset")
PLUGINS = "plugins"
"""A field more, of models that were trained with plugins."""
HEAD = re.compile(rb'\{\n  "sha256": "([0-9a-f]{64})",\n')
LARGEST_TEXT = 2**20
"""Bytes of a configuration, and of the names and shapes of all parameters."""


def save_model(folder: Path | str, model: Model, card: str | None = None) -> None:
    """Write `model` as a new folder, which appears whole or not at all.

    Args:
        folder: of the model.
        model: parameters are nested dictionaries of finite arrays that fit the configuration.
        card: text of its `README.md`; by default what the configuration says.

    Raises:
        InputError: when something is already there or cannot be written, and for a model that
            would not be read as it is.
    """
    config, params = _files(model)
    with new_folder(folder) as beside:
        (beside / PARAMS).write_bytes(params)
        (beside / CONFIG).write_bytes(config)
        (beside / CARD).write_text(_card(model) if card is None else card, encoding="utf-8")


def load_model(path: Path | str) -> Model:
    """Read a model's folder or a torch checkpoint of SGAN or NeuroSyM.

    Args:
        path: of the folder or file, the name of a model that ships (`neurosym_zara1_8_8`), or a
            path among the downloads (`sgan-p-models/zara1_8_model.pt`): `neurosym models` lists
            what is at hand.

    Raises:
        InputError: for anything that is not such a thing, is damaged, or has another format.
    """
    path = find_model(path)
    if os.path.isfile(path):
        from neurosym_jax.interop.torch import load_torch_checkpoint

        checkpoint = load_torch_checkpoint(path)
        return Model(checkpoint.config, {"params": checkpoint.params}, checkpoint.scene)
    if not os.path.exists(path):
        raise InputError(f"{path}: no such checkpoint (`neurosym models` lists what is at hand)")
    if not (path / CONFIG).is_file():
        raise InputError(f"{path}: not a model's folder: it has no {CONFIG}")
    try:
        with (path / CONFIG).open("rb") as file:
            config = file.read(LARGEST_TEXT + 1)
        head = HEAD.match(config)
        if head is None or len(config) > LARGEST_TEXT:
            raise InputError(f"not a model's {CONFIG}, or a damaged one")
        return _read(path, config[head.end() :], head[1].decode())
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or type(error).__name__}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(path: Path, config: bytes, sha256: str) -> Model:
    """The model of a folder, from what follows the digest in its configuration."""
    params = path / PARAMS
    if not params.is_file():
        raise InputError(f"it has no {PARAMS}")
    with params.open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
        file.seek(0)
        if hashlib.file_digest(file, lambda: hashlib.sha256(config)).hexdigest() != sha256:
            raise InputError(f"damaged: {CONFIG} and {PARAMS} do not match their digest")
    if size > LARGEST_TEXT:
        raise InputError(f"{PARAMS}: {size} bytes of names are more than {LARGEST_TEXT}")
    refuse_beyond_memory(PARAMS, 3 * params.stat().st_size, "free some")
    try:
        fields: Any = json.loads(b"{" + config)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{CONFIG}: not JSON ({error})") from None
    if type(fields.get("format")) is not int or fields["format"] != FORMAT:
        raise InputError(
            f"format {fields.get('format')!r} is not the format {FORMAT} of this version"
        )
    kind, values, dataset = (fields.get(name) for name in FIELDS[1:])
    plugins = fields.pop(PLUGINS, [])
    if set(fields) != set(FIELDS) or not isinstance(kind, str) or not isinstance(values, dict):
        raise InputError(f"{CONFIG}: must have the fields {', '.join(FIELDS)} and no others")
    if not isinstance(dataset, str | None):
        raise InputError(f"{CONFIG}: dataset = {dataset!r} is not a name")
    if not isinstance(plugins, list) or not all(isinstance(name, str) for name in plugins):
        raise InputError(f"{CONFIG}: {PLUGINS} = {plugins!r} are not names")
    try:
        of_kind = _config(kind, values)
    except InputError as error:
        absent = [f" --plugin {name}" for name in plugins if name not in names(loaded())]
        hint = f"; it was trained with{''.join(absent)}" if absent else ""
        raise InputError(f"{error}{hint}") from None
    model = Model(of_kind, nested_parameters(_arrays(params)), dataset, kind, tuple(plugins))
    refuse_misfit(model)
    return model


def _arrays(path: Path) -> dict[str, np.ndarray]:
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        return load_file(path)
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path.name}: cannot be read ({error})") from None


def _config(kind: str, values: dict[str, Any]) -> Any:
    return configuration.from_json(FORECASTERS[kind].Config, values, CONFIG)


def _files(model: Model) -> tuple[bytes, bytes]:
    """What `config.json` and `params.safetensors` hold."""
    from safetensors.numpy import save

    refuse_misfit(model)
    params = save(flat_parameters(model.params))
    values = configuration.to_json(model.config)
    head = (FORMAT, model.kind, values, model.dataset)
    fields: dict[str, Any] = dict(zip(FIELDS, head, strict=True))
    if model.plugins:
        fields[PLUGINS] = model.plugins
    try:
        rest = json.dumps(fields, indent=2, allow_nan=False).removeprefix("{\n").encode() + b"\n"
    except (TypeError, ValueError) as error:
        raise InputError(f"the configuration of {model.name} is not JSON ({error})") from None
    if _config(model.kind, json.loads(b"{" + rest)["config"]) != model.config:
        raise InputError(f"the configuration of {model.name} does not come back from JSON")
    sha256 = hashlib.sha256(rest + params).hexdigest()
    return f'{{\n  "sha256": "{sha256}",\n'.encode() + rest, params


def refuse_misfit(model: Model) -> None:
    """Refuse parameters that are not those that the configuration describes.

    Raises:
        InputError: naming what is not finite, missing, unexpected or misshapen.
    """
    flat = flat_parameters(model.params)
    refuse_not_finite(flat)
    wanted = model.forecaster.shapes()
    if wanted is None:
        return
    given = {name: array.shape for name, array in flat.items()}
    wrong = [
        f"{name} is {given.get(name, 'absent')}, not {wanted.get(name, 'expected')}"
        for name in {**wanted, **given}
        if wanted.get(name) != given.get(name)
    ]
    if wrong:
        raise InputError(f"the configuration describes another network: {listed(wrong, 2)}")


def _card(model: Model) -> str:
    config = model.config
    without = "" if model.dataset is None else f", to be tested on {model.dataset}"
    return (
        f"# {model.name}{without}\n\n"
        f"Forecasts {config.pred_len} steps of {config.period:g} s from {config.obs_len} observed "
        "ones. `neurosym_jax.load_model` reads this folder.\n"
    )
