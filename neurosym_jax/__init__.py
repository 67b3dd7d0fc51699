"""Human motion prediction in JAX: SGAN and NeuroSyM, as functions of one scene."""

from neurosym_jax.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.scene import Scene, make_scene

__all__ = [
    "DiscriminatorConfig",
    "GeneratorConfig",
    "InputError",
    "Model",
    "Scene",
    "load_model",
    "make_scene",
    "predict",
    "save_model",
]
