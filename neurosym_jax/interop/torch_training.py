"""A training of SGAN in torch, continued here: both networks and the states of their Adams."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.interop.checkpoint import discriminator, generator
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

__all__ = ["TorchTraining", "load_torch_training", "recipe_of"]

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
NETWORKS = "g_state", "d_state", "g_optim_state", "d_optim_state"


class TorchTraining(NamedTuple):
    """What SGAN's training saved, as `models.learn` takes it."""

    config: GeneratorConfig
    recipe: GeneratorRecipe
    """The recipe `sgan` with the arguments of the training."""
    state: TrainState


def load_torch_training(path: str | os.PathLike) -> TorchTraining:
    """The networks and optimisers of a checkpoint that SGAN's `train.py` wrote to `path`.

    Raises:
        InputError: naming `path` and what is missing or wrong; a checkpoint without a
            discriminator or optimisers holds no training.
    """
    contents = read_torch_file(path)
    try:
        return _training_of(contents, Path(path).name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def recipe_of(arguments: Mapping[str, Any], source: str = "args") -> GeneratorRecipe:
    """The recipe `sgan` with the arguments of a training.

    Raises:
        InputError: naming `source` and the argument that is out of its range.
    """
    fields = {
        field: arguments[name] for name, field in ARGUMENTS.items() if name in arguments
    }
    return from_json(GeneratorRecipe, {**vars(RECIPES["sgan"]), **fields}, source)


def _training_of(contents: Any, source: str) -> TorchTraining:
    for name in ("args", *NETWORKS):
        if not isinstance(contents, Mapping) or not isinstance(
            contents.get(name), Mapping
        ):
            raise InputError(f"has no {name}: not a checkpoint of a training")
    arguments = contents["args"]
    config, params = generator(arguments, contents["g_state"])
    # The names of its discriminator's sizes end in _d.
    critic_config, critic = discriminator(arguments, contents["d_state"])
    recipe = recipe_of(arguments, source)
    recipe = dataclasses.replace(recipe, discriminator=critic_config)
    state = new_state(recipe, {"params": params})
    adam = _adam_state(contents, "g", config, arguments)
    state = state._replace(
        step=jnp.asarray(adam["count"], jnp.int32),
        optimizer=optax.tree_utils.tree_set(state.optimizer, **adam),
    )
    adversary = init_adversary(recipe, {"params": critic})
    adam = _adam_state(contents, "d", critic_config, arguments)
    optimizer = optax.tree_utils.tree_set(adversary.optimizer, **adam)
    return TorchTraining(
        config, recipe, state._replace(extra=Adversary(adversary.params, optimizer))
    )


def _adam_state(
    contents: Mapping[str, Any],
    network: str,
    config: GeneratorConfig | DiscriminatorConfig,
    arguments: Mapping[str, Any],
) -> dict[str, Any]:
    """`count`, `mu` and `nu` of optax's Adam, of the optimiser of `network`, g or d.

    Torch numbers the parameters in the order of the network's state dict. Those that
    never had a gradient have no entry.
    """
    parameters = without_dropout(contents[f"{network}_state"], arguments)
    entries = contents[f"{network}_optim_state"].get("state", {})
    moments: dict[str, dict[str, np.ndarray]] = {"exp_avg": {}, "exp_avg_sq": {}}
    count = 0
    for number, (name, value) in enumerate(parameters.items()):
        entry = entries.get(number, {})
        count = max(count, int(np.asarray(entry.get("step", 0))))
        for moment, arrays in moments.items():
            arrays[name] = np.asarray(entry.get(moment, np.zeros_like(value)))
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
