"""The family of SGAN and NeuroSyM: a generator encodes a scene once, and decodes each noise."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import NoiseSpec, TwoStageForecaster, checked_key
from neurosym_jax.models.sgan.network import (
    LSTM,
    NO_FORECAST,
    POOLINGS,
    GeneratorConfig,
    decode_scene,
    encode_scene,
    init_generator,
)
from neurosym_jax.models.sgan.training import (
    RECIPES,
    batch_loss,
    generator_rounds,
    init_state,
)
from neurosym_jax.scene import Scene
from neurosym_jax.training.batches import SceneStream

__all__ = ["GeneratorForecaster"]


@dataclasses.dataclass(frozen=True)
class GeneratorForecaster(TwoStageForecaster):
    """A `Generator`: encoding and pooling once, then one decoding for each noise."""

    config: GeneratorConfig

    Config: ClassVar[type] = GeneratorConfig
    configs: ClassVar[Mapping[str, Any]] = {
        "sgan": GeneratorConfig(),
        "neurosym": GeneratorConfig(pooling=POOLINGS["as_described"]()),
    }
    recipes: ClassVar[Mapping[str, Any]] = RECIPES

    @property
    def model(self) -> str:
        """`neurosym` if its pooling weights pairs, else `sgan`; a subclass's key."""
        if self.Config is not GeneratorConfig:
            return self.key
        weighted = self.config.pooling.inputs & {"alpha", "alpha_rows"}
        return "neurosym" if weighted else "sgan"

    @property
    def variant(self) -> str:
        """The model, its pooling and weighting."""
        pooling = POOLINGS.name_of(self.config.pooling)
        weighting = self.config.weighting
        if weighting is None:
            return f"sgan_{pooling}"
        return f"neurosym_{pooling.removeprefix('neurosym_')}_{weighting.name}"

    @property
    def title(self) -> str:
        """The pooling's title, the cell unless an LSTM, and the weighting."""
        cell, weighting = self.config.cell, self.config.weighting
        parts = [self.config.pooling.title]
        parts += [] if isinstance(cell, LSTM) else [cell.title]
        parts += [] if weighting is None else [weighting.name]
        return ", ".join(parts)

    @property
    def unfit(self) -> str:
        """See `pooling.NO_FORECAST`."""
        rows = "alpha_rows" in self.config.pooling.inputs
        if rows:
            return f"{POOLINGS.name_of(self.config.pooling)} {NO_FORECAST}"
        return ""

    def init(self, key: Array) -> Any:
        """See `Forecaster.init`."""
        return init_generator(self.config, checked_key(key))

    @property
    def noise(self) -> NoiseSpec:
        """The config's."""
        return self.config.noise

    @property
    def state_size(self) -> int:
        """Gates and cell, and the perceptron before the first step; measured: 360 for SGAN's."""
        config = self.config
        return 8 * config.decoder_h_dim + config.mlp_dim + config.encoder_h_dim

    @property
    def sees_neighbours(self) -> bool:
        """Whether it has a pooling."""
        return self.config.pools

    @property
    def encoder(self) -> "GeneratorForecaster | None":
        """Encoding does not depend on the horizon; without pooling it is part of `decode`."""
        if not self.config.pools:
            return None
        return GeneratorForecaster(dataclasses.replace(self.config, pred_len=1))

    @property
    def decodes_alone(self) -> bool:
        """Unless it pools at every step."""
        return not self.config.pool_every_timestep

    def encode(self, params: Any, scene: Scene) -> Any:
        """Context `[N, C]`, see `encode_scene`."""
        if self.config.pools:
            return encode_scene(self.config, params, scene)
        return ()

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """See `TwoStageForecaster.decode`."""
        if not self.config.pools:
            context = encode_scene(self.config, params, scene)
        return decode_scene(self.config, params, context, scene, noise)

    def best_of(self, recipe: Any) -> int:
        """The recipe's."""
        return recipe.best_k

    def init_state(self, recipe: Any, key: Array) -> Any:
        """See `step.init_state`: a recipe may have a discriminator."""
        return init_state(self.config, recipe, key)

    def batches(self, windows: Any, recipe: Any) -> Callable[[int], Any]:
        """See `Forecaster.batches`; crowds are cropped as the recipe says."""
        batch_scenes, seed = recipe.batch_scenes, recipe.seed
        return SceneStream(windows, batch_scenes, seed, recipe.max_agents).batch

    def loss(
        self, params: Any, batch: Any, key: Array, recipe: Any
    ) -> tuple[Array, Any]:
        """The variety loss of the recipe's criterion."""
        return batch_loss(self.config, recipe, params, batch, key)

    def rounds(
        self, windows: Any, recipe: Any, key: Array
    ) -> Callable[..., tuple[Any, Any]]:
        """A round is one compiled call, see `training.train_steps`.

        Raises:
            InputError: for a loss or batches of a subclass that would not be used.
        """
        family = type(self)
        if recipe.adversarial_weight and family.loss is not GeneratorForecaster.loss:
            raise InputError(
                f"adversarial_weight {recipe.adversarial_weight:g} trains by SGAN's "
                f"losses and would not call {family.__name__}.loss: set it to 0"
            )
        if family.batches is not GeneratorForecaster.batches:
            return super().rounds(windows, recipe, key)
        return generator_rounds(self, windows, recipe, key)
