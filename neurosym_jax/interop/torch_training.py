"""A training of SGAN or NeuroSyM in torch, continued here: both networks and their Adams."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError, brief
from neurosym_jax.interop.checkpoint import Contents, discriminator, generator
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.models.sgan.network import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.sgan.torch_names import params_from_torch, without_dropout
from neurosym_jax.models.sgan.training import (
    RECIPES,
    Adversary,
    GeneratorRecipe,
    init_adversary,
)
from neurosym_jax.training.state import TrainState, new_state

__all__ = [
    "TorchTraining",
    "adam_entries",
    "load_torch_training",
    "recipe_of",
    "training_from_torch",
]

ARGUMENTS = {
    "best_k": "best_k",
    "batch_size": "batch_scenes",
    "g_learning_rate": "learning_rate",
    "d_learning_rate": "d_learning_rate",
    "clipping_threshold_g": "clip_norm",
    "l2_loss_weight": "variety_weight",
    "d_steps": "discriminator_steps",
}
"""SGAN's arguments, and the fields of a recipe that they are."""
ONE_WAY = {"g_steps": 1, "clipping_threshold_d": 0}
"""Arguments of SGAN's training that ours has in one form only."""
ADAM = {
    "betas": (0.9, 0.999),
    "eps": 1e-8,
    "weight_decay": 0,
    "amsgrad": False,
    "maximize": False,
}
"""The options of torch's Adam that SGAN's training uses, and ours has."""
RATES = {"g": "learning_rate", "d": "d_learning_rate"}
"""Fields of a recipe that are learning rates, by torch's letter for the network."""
STATES = "g_state", "d_state", "g_optim_state", "d_optim_state"


class TorchTraining(NamedTuple):
    """What SGAN's training saved, as `models.learn` takes it."""

    config: GeneratorConfig
    recipe: GeneratorRecipe
    """The recipe `sgan` with the arguments of the training."""
    state: TrainState


def load_torch_training(path: str | os.PathLike) -> TorchTraining:
    """The networks and optimisers of a checkpoint that SGAN's `train.py` wrote to `path`.

    NeuroSyM's `train_informed.py` writes the same.

    Raises:
        InputError: naming `path` and what is missing or wrong; a checkpoint without a
            discriminator or optimisers holds no training.
    """
    contents = read_torch_file(path)
    try:
        parts = contents if isinstance(contents, Mapping) else {}
        for name in ("args", *STATES):
            if not isinstance(parts.get(name), Mapping):
                raise InputError(f"has no {name}: not a checkpoint of a training")
        return training_from_torch(contents, Path(path).name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def recipe_of(contents: Contents, source: str = "args") -> GeneratorRecipe:
    """The recipe `sgan` with the arguments of a training, and its optimisers' learning rates.

    Raises:
        InputError: naming `source` and the argument that is out of its range, or that
            our training lacks.
    """
    arguments = contents["args"]
    for name, value in ONE_WAY.items():
        if arguments.get(name, value) != value:
            raise InputError(
                f"args: {name} is {brief(arguments[name])}, and our training has {value}"
            )
    fields = {**vars(RECIPES["sgan"])}
    for name, field in ARGUMENTS.items():
        if name in arguments:
            fields[field] = arguments[name]
    for network, field in RATES.items():
        group = _adam_group(contents, network)
        # Torch goes on at the rate of the optimiser's state, whatever the arguments say.
        fields[field] = group.get("lr", fields[field])
    return from_json(GeneratorRecipe, fields, source)


def training_from_torch(contents: Contents, source: str = "args") -> TorchTraining:
    """The training in the dictionary that SGAN's training saves.

    A network without the state of its optimiser gets a new one.

    Raises:
        InputError: naming what is wrong.
    """
    arguments = contents["args"]
    config, params = generator(arguments, contents["g_state"])
    # The names of its discriminator's sizes end in _d.
    critic_config, critic = discriminator(arguments, contents["d_state"])
    recipe = recipe_of(contents, source)
    recipe = dataclasses.replace(recipe, discriminator=critic_config)
    state = new_state(recipe, {"params": params})
    adam = _adam_state(contents, "g", config)
    state = state._replace(
        step=jnp.asarray(adam["count"], jnp.int32),
        optimizer=optax.tree_utils.tree_set(state.optimizer, **adam),
    )
    adversary = init_adversary(recipe, {"params": critic})
    adam = _adam_state(contents, "d", critic_config)
    optimizer = optax.tree_utils.tree_set(adversary.optimizer, **adam)
    state = state._replace(extra=Adversary(adversary.params, optimizer))
    return TorchTraining(config, recipe, state)


def adam_entries(contents: Contents, network: str) -> dict[int, Mapping[str, Any]]:
    """`step`, `exp_avg` and `exp_avg_sq` by a parameter's place in the network's state dict.

    `network` is g or d. Parameters that never had a gradient have no entry.
    """
    state = contents.get(f"{network}_optim_state", {}).get("state", {})
    # Torch numbers parameters; up to 0.4 it named them by their addresses.
    names = _adam_group(contents, network).get("params", [])
    return {place: state[name] for place, name in enumerate(names) if name in state}


def _adam_group(contents: Contents, network: str) -> Mapping[str, Any]:
    """Options and parameters of the network's optimiser, if the checkpoint has one."""
    groups = contents.get(f"{network}_optim_state", {}).get("param_groups", [{}])
    if len(groups) != 1:
        raise InputError(
            f"{network}_optim_state: has {len(groups)} groups of parameters, not one"
        )
    (group,) = groups
    for name, value in ADAM.items():
        setting = group.get(name, value)
        if isinstance(setting, list):
            setting = tuple(setting)
        if setting != value:
            raise InputError(
                f"{network}_optim_state: {name} is {brief(setting)}, and our Adam has {value}"
            )
    return group


def _adam_state(
    contents: Contents,
    network: str,
    config: GeneratorConfig | DiscriminatorConfig,
) -> dict[str, Any]:
    """`count`, `mu` and `nu` of optax's Adam, of the optimiser of `network`, g or d."""
    parameters = without_dropout(contents[f"{network}_state"], contents["args"])
    entries = adam_entries(contents, network)
    moments: dict[str, dict[str, np.ndarray]] = {"exp_avg": {}, "exp_avg_sq": {}}
    count = 0
    for place, (name, value) in enumerate(parameters.items()):
        entry = entries.get(place, {})
        count = max(count, int(np.asarray(entry.get("step", 0))))
        for moment, arrays in moments.items():
            # As torch does, in the type of the parameter.
            array = entry.get(moment, np.zeros_like(value))
            arrays[name] = np.asarray(array, value.dtype)
            if arrays[name].shape != value.shape:
                raise InputError(
                    f"{network}_optim_state: {moment} of {name} is "
                    f"{list(arrays[name].shape)}, not {list(value.shape)}"
                )
    mu, nu = (params_from_torch(arrays, config) for arrays in moments.values())
    return {
        "count": jnp.asarray(count, jnp.int32),
        "mu": {"params": mu},
        "nu": {"params": nu},
    }
