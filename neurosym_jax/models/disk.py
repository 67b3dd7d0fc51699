"""Models on disk: where they are, by name or path, and folders of three files."""

import dataclasses
import difflib
import json
import os
import re
import shutil
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

import neurosym_jax
from neurosym_jax.configuration import Checked, from_json, parse_json, to_json
from neurosym_jax.data.recordings import GENERAL, SCENES, data_folder, find
from neurosym_jax.data.windows import VERSION, is_fingerprint
from neurosym_jax.errors import InputError, InputWarning, option, warn_caller
from neurosym_jax.models.forecast import Model, digest_of, refuse_no_model
from neurosym_jax.models.forecaster import (
    FORECASTERS,
    flat_parameters,
    nested_parameters,
    refuse_misfit,
    shapes_of,
)
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.files import new_folder, replaced_folder

__all__ = [
    "DOWNLOADED",
    "RECOMMENDED",
    "find_model",
    "find_models",
    "load_model",
    "models_at_hand",
    "replace_card",
    "save_model",
    "shipped_models",
    "shipped_name",
    "spoken_name",
    "state_of_run",
]


# Where models are: what a name means, which models ship, and which were downloaded.

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

    Raises:
        InputError: for `recommended` with another number of steps than ships.

    Warns:
        InputWarning: for a path that has the name of a shipped model.
    """
    path, name = Path(path), Path(path)
    if str(path) == RECOMMENDED:
        name = Path(shipped_name("anchors", dataset, pred_len or 8))
    shipped = _shipped_folder() / name
    if name != path and not (os.path.isdir(shipped) or os.path.exists(path)):
        _refuse_unshipped_length(pred_len or 8)
    # os.path, unlike Path, takes a name that is too long for one that does not exist.
    if not name.name or not os.path.isdir(shipped):
        return _model_of_run(find(path if os.path.exists(path) else name))
    if not _holds_models(path):
        return shipped
    if not os.path.samefile(path, shipped):
        line = f"{path}: the one in this folder, not the model of this name that ships"
        warnings.warn(line, InputWarning, stacklevel=2)
    return _model_of_run(path)


def _refuse_unshipped_length(pred_len: int) -> None:
    """Say what `recommended` forecasts, if no shipped network forecasts `pred_len` steps."""
    names = [path.name for path in shipped_models() if path.name.startswith("anchors_")]
    lengths = sorted({int(name.rpartition("_")[2]) for name in names})
    if pred_len not in lengths:
        raise InputError(
            f"{RECOMMENDED} forecasts {' or '.join(map(str, lengths))} steps, not {pred_len}: "
            f"neurosym train --family anchors --pred-len {pred_len} trains a model for them"
        )


def _model_of_run(path: Path) -> Path:
    """The model in the folder of a training; another path unchanged."""
    is_model = os.path.exists(path / "config.json")
    model = path / "model"
    if not is_model and os.path.isdir(model):
        return model
    return path


def spoken_name(typed: Path | str, path: Path, model: Model) -> str:
    """What messages call a model at `path` that was `typed`: `recommended (anchors_eth_8)`.

    Others than `recommended` are called by their forecaster's title.
    """
    return f"{typed} ({path.name})" if str(typed) == RECOMMENDED else model.name


def state_of_run(path: str, step: int) -> str:
    """What state a model is that was kept after `step` steps of a training, in words."""
    run = find_model(path).parent
    is_finished = (run / "run.json").exists()
    goes_on = (run / "checkpoints").is_dir() and not is_finished
    unfinished = ", which is not finished" if goes_on else ""
    return f"{path}: the state after {step} steps of its training{unfinished}"


def find_models(
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
            own = [find_model(name, dataset, pred_len).name for dataset in datasets]
            paths += dict.fromkeys(own)
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
    folders = [path.parent for path in folder.glob("*/config.json")]
    return sorted([*folder.glob("*.pt"), *folders])


def _shipped_folder() -> Path:
    """`checkpoints`: in the package where that is installed, beside it in a clone."""
    package = Path(neurosym_jax.__path__[0])
    within = package / "checkpoints"
    if within.is_dir():
        return within
    return package.parent / "checkpoints"


# Models on disk: folders of three files and, read through `interop`, torch's
# checkpoints.
#
# A model's folder holds `config.json` (the forecaster's name and configuration, the
# dataset to test on, the names of plugins it was trained with, which are never imported
# from here, and where measured the neighbour effect), `params.safetensors` (arrays by
# path, such as `params/mlp/bias`) and `README.md`, the card for people. The second line
# of `config.json` is the digest of everything else:
#
#     (tail -n +3 config.json; cat README.md params.safetensors) | sha256sum
#
# It is compared before any file is parsed.

FILES = CONFIG, PARAMS, CARD = "config.json", "params.safetensors", "README.md"
FORMAT = 3
HUB_LICENCES = {"MIT": "mit", "CC BY-NC-SA 3.0, restricted": "cc-by-nc-sa-3.0"}
"""Our names of data's licences, and the Hub's."""
OPTIONAL = ("seed", "seen", "neighbours", "data", "step", "recipe")
"""Fields of a model that its file has where they are known."""
HEAD = re.compile(rb'\{\n  "sha256": "([0-9a-f]{64})",\n')


@dataclasses.dataclass(frozen=True)
class _File(Checked):
    """The fields of `config.json` after the digest: those of `Model`."""

    format: int
    forecaster: str
    config: dict
    dataset: str | None
    plugins: tuple[str, ...]
    seed: int | None = None
    seen: str = ""
    neighbours: float | None = None
    data: dict[str, str] | None = None
    step: int | None = None
    recipe: str = ""


def save_model(
    folder: Path | str, model: Model, card: str | None = None, *, replace: bool = False
) -> None:
    """Write `model` as a new folder, which appears whole or not at all.

    `card` is the text of its `README.md`, by default a summary of the configuration; it
    gets the header of the Hugging Face Hub unless it has one. With `replace` it takes
    the place of what is there.

    Raises:
        InputError: if something is already there or cannot be written, and for a model
            that would not come back as it is.
    """
    from safetensors.numpy import save

    refuse_no_model(model)
    _refuse_misfit(model)
    fields = {
        "format": FORMAT,
        "forecaster": model.family,
        "config": to_json(model.config),
        "dataset": model.dataset,
        "plugins": list(model.plugins),
    }
    optional = {name: getattr(model, name) for name in OPTIONAL}
    optional["data"] = dict(model.data)
    for name, value in optional.items():
        if value not in ("", None, {}):
            fields[name] = value
    text = json.dumps(fields, indent=2, allow_nan=False)
    written = json.loads(text)["config"]
    if from_json(type(model.config), written, CONFIG) != model.config:
        raise InputError(
            f"the configuration of {model.name} does not come back from JSON"
        )
    with (replaced_folder if replace else new_folder)(folder) as beside:
        (beside / PARAMS).write_bytes(save(flat_parameters(model.params)))
        text_of_card = _headed(_card(model) if card is None else card, model.data)
        (beside / CARD).write_text(text_of_card, encoding="utf-8")
        _write_config(beside / CONFIG, beside, f"{text[2:]}\n".encode())


def replace_card(folder: Path, card: str) -> None:
    """Replace the card of the model in `folder`, whose digest follows.

    The folder is replaced whole: a card without its digest would be a damaged model.
    """
    _, rest = _read_config(folder)
    data = parse_json(b"{" + rest, CONFIG).get("data", {})
    with replaced_folder(folder) as beside:
        shutil.copyfile(folder / PARAMS, beside / PARAMS)
        (beside / CARD).write_text(_headed(card, data), encoding="utf-8")
        _write_config(beside / CONFIG, beside, rest)


def load_model(
    path: Path | str, *, dataset: str | None = None, pred_len: int | None = None
) -> Model:
    """Read a model's folder or a torch checkpoint of SGAN or NeuroSyM.

    Args:
        path: of the folder or file, the name of a shipped model (`neurosym_zara1_8`), a
            path among the downloads (`sgan-p-models/zara1_8_model.pt`), or
            `recommended`: `neurosym models --all` lists them.
        dataset: what `recommended` is to be tested on; of ETH/UCY, the model was
            trained without.
        pred_len: steps that `recommended` is to forecast; default: 8.

    Raises:
        InputError: for a path that is no model, is damaged, or has another format.
    """
    typed, path = str(path), find_model(path, dataset, pred_len)
    # A folder of this name may lie here, and holds another model.
    ships = path.parent == _shipped_folder()
    called = RECOMMENDED if typed == RECOMMENDED and ships else ""
    if os.path.isfile(path):
        from neurosym_jax.interop.checkpoint import load_torch_checkpoint

        return load_torch_checkpoint(path)
    if not os.path.exists(path):
        names_here = [RECOMMENDED, *(name for name, _ in models_at_hand())]
        near = difflib.get_close_matches(str(path), names_here, 1)
        # A kind, such as sgan, is the beginning of names.
        near += [name for name in names_here if name.startswith(f"{path}_")][:1]
        hint = "`neurosym models --all` lists those here"
        if near:
            hint = f"did you mean {near[0]}?"
        raise InputError(f"{path}: no such model ({hint})")
    try:
        return dataclasses.replace(_read(path), called=called)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or type(error).__name__}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_config(folder: Path) -> tuple[str, bytes]:
    """The digest in `config.json`, and the text after it."""
    if not (folder / CONFIG).is_file():
        raise InputError(f"not a model's folder: it has no {CONFIG}")
    config = (folder / CONFIG).read_bytes()
    head = HEAD.match(config)
    if head is None:
        raise InputError(f"not a model's {CONFIG}, or a damaged one")
    return head[1].decode(), config[head.end() :]


def _write_config(path: Path, folder: Path, rest: bytes) -> None:
    """Write `config.json` with the digest of `rest` and of the other files in `folder`."""
    contents = [(folder / name).read_bytes() for name in (CARD, PARAMS)]
    head = f'{{\n  "sha256": "{digest_of(rest, *contents)}",\n'
    path.write_bytes(head.encode() + rest)


def _read(folder: Path) -> Model:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    digest, rest = _read_config(folder)
    for name in (CARD, PARAMS):
        if not (folder / name).is_file():
            raise InputError(f"it has no {name}")
    # Read once: the bytes that are parsed are those that were checked.
    card, parameter_bytes = ((folder / name).read_bytes() for name in (CARD, PARAMS))
    if digest_of(rest, card, parameter_bytes) != digest:
        raise InputError("damaged: its files do not match the digest")
    fields = from_json(_File, parse_json(b"{" + rest, CONFIG), CONFIG)
    if fields.format != FORMAT:
        raise InputError(
            f"format {fields.format} is not the format {FORMAT} of this version"
        )
    if not is_fingerprint(fields.seen):
        raise InputError(f"{CONFIG}: seen is not a fingerprint of windows")
    try:
        config = from_json(FORECASTERS[fields.forecaster].Config, fields.config, CONFIG)
    except InputError as error:
        absent = [name for name in fields.plugins if name not in names(loaded())]
        plugins = " ".join(option("plugin", name) for name in absent)
        hint = f"; it was trained with {plugins}" if absent else ""
        raise InputError(f"{error}{hint}") from None
    try:
        parameters = nested_parameters(load(parameter_bytes))
    except KeyError as error:  # Its name of a type of numbers.
        raise InputError(f"{PARAMS}: numpy has no numbers of type {error}") from None
    except (SafetensorError, AttributeError, ValueError, TypeError) as error:
        raise InputError(f"{PARAMS}: cannot be read ({error})") from None
    optional: dict[str, Any] = {name: getattr(fields, name) for name in OPTIONAL}
    optional["data"] = fields.data or {}
    if fields.seen and not fields.seen.startswith(VERSION):
        optional["seen"] = ""
        warn_caller(
            f"{folder}: an earlier version kept shapes of its training otherwise: a test "
            "on people that it was trained on is not noticed"
        )
    model = Model(
        config,
        parameters,
        fields.dataset,
        fields.forecaster,
        fields.plugins,
        **optional,
    )
    _refuse_misfit(model)
    return model


def _refuse_misfit(model: Model) -> None:
    """Refuse parameters that are not finite or do not fit the configuration."""
    flat = flat_parameters(model.params)
    shapes = model.forecaster.shapes()
    # Where no shapes are known, any will do.
    fields = shapes_of(flat if shapes is None else shapes)
    refuse_misfit(flat, fields, "the configuration describes another network")


def _card(model: Model) -> str:
    config = model.config
    tested = f", to be tested on {model.dataset}" if model.dataset else ""
    assumed = f"\nAssumed of its torch checkpoint: {'; '.join(model.assumed)}.\n"
    return (
        f"# {model.forecaster.title}{tested}\n\n"
        f"Forecasts {config.pred_len} steps of {config.period:g} s from {config.obs_len} observed "
        f"ones. `neurosym_jax.load_model` reads this folder.\n{assumed if model.assumed else ''}"
    )


def _headed(card: str, data: Mapping[str, str]) -> str:
    """The card with the header that the Hugging Face Hub reads; `data` as `Model.data`."""
    if card.startswith("---\n"):
        return card
    licences = {HUB_LICENCES.get(licence, "unknown") for licence in data.values()}
    if not data:
        licences = {"unknown"}
    header = {
        "library_name": "neurosym_jax",
        "pipeline_tag": "time-series-forecasting",
        "license": licences.pop() if len(licences) == 1 else "other",
        "datasets": [name.lower().replace("/", "-") for name in data],
        "dataset_licenses": dict(data),
        "metrics": ["ade", "fde"],
        "tags": ["trajectory-prediction", "jax"],
    }
    return f"---\n{yaml.safe_dump(header, sort_keys=False)}---\n\n{card}"
