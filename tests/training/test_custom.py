"""A loss, an optimiser and a schedule of one's own are used, recorded, and refused in words."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.models import GeneratorForecaster
from neurosym_jax.models.anchors.network import AnchorTableConfig
from neurosym_jax.models.forecaster import FORECASTERS, forecaster_of
from neurosym_jax.training.custom import make_custom
from neurosym_jax.training.run import known_configs
from neurosym_jax.training.state import new_state, update
from tests.training.conftest import GENERATOR, RECIPE, random_walks

TRAINING, VALIDATION = random_walks([4] * 8), random_walks([2, 3, 4, 3], seed=9)
SHORT = dataclasses.replace(RECIPE, steps=25, best_k=2, ema=0.9)
SOFT = dataclasses.replace(
    GENERATOR,
    pooling="as_described,bottleneck_dim=4,hidden_dim=16",
    weighting="soft,learned=true",
)


def far_ahead(forecast, scene):
    """Everybody should be 50 m to the right of where they are: nobody's future is."""
    goal = jnp.asarray(scene.observed)[:, -1, None] + jnp.array([[50.0, 0.0]])
    distance = jnp.abs(forecast - goal[None]).sum(-1)
    return jnp.where(scene.valid[None, :, None], distance, 0).mean()


def anneal(step):
    """The logarithm of a temperature that halves in 25 steps."""
    return jnp.log(0.1) - step * jnp.log(2.0) / 25


@pytest.mark.slow
def test_all_three_are_used_and_recorded(tmp_path):
    model = nj.train(
        TRAINING, VALIDATION, tmp_path, config=SOFT, recipe=SHORT, quiet=True,
        loss=far_ahead, optimizer=optax.contrib.prodigy(1.0),
        schedule={"weighting.log_temperature": anneal},
    )  # fmt: skip
    # Scheduled to the last step, in the averaged parameters too.
    kept = float(model.params["weighting"]["log_temperature"])
    assert kept == pytest.approx(float(anneal(25)), rel=1e-6)
    facts = json.loads((tmp_path / "run.json").read_text())["custom"]
    assert facts == {
        "own loss": "far_ahead",
        "own optimizer": "prodigy",
        "own schedule": "weighting.log_temperature by anneal",
    }
    assert "far_ahead" in (tmp_path / "model" / "README.md").read_text()
    rows = [
        json.loads(x) for x in (tmp_path / "metrics.jsonl").read_text().splitlines()
    ]
    # Sums of |x| and |y| to a point 50 m ahead.
    assert 40 < rows[-1]["g_loss"] < 60


@pytest.mark.slow
def test_a_family_without_rounds_of_its_own_takes_a_loss(tmp_path):
    config = AnchorTableConfig(obs_len=4, pred_len=3, samples=3)
    recipe = nj.AnchorRecipe(
        steps=1, batch_scenes=4, validate_every=1, learning_rate=0.1, ema=0.0
    )
    made = [
        nj.train(
            TRAINING, VALIDATION, tmp_path / str(index), config=config, recipe=recipe,
            quiet=True, loss=loss,
        )
        for index, loss in enumerate([None, far_ahead])
    ]  # fmt: skip
    assert not np.array_equal(*(model.params["params"]["moving"] for model in made))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": 3}, "loss: must be a function"),
        ({"optimizer": 0.1}, "optimizer: must be one of optax"),
        ({"schedule": {"weighting.speed": 0.1}}, "must be a function of the step"),
        ({"schedule": {"factor": lambda step, rate: 0}}, "must be a function of the"),
        ({"schedule": "factor"}, "schedule: must be a dictionary of functions"),
        ({"loss": lambda forecast: 0.0}, "loss: must be a function"),
        ({"optimizer": optax.adam}, "optimizer: must be one of optax"),
    ],
)
def test_what_is_none_is_refused(options, message):
    arguments = {"loss": None, "optimizer": None, "schedule": None, **options}
    with pytest.raises(InputError, match=message):
        make_custom(**arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recipe", "options", "message"),
    [
        (
            {"adversarial_weight": 1.0},
            {"loss": far_ahead},
            "adversarial_weight 1 trains by SGAN's losses and would not call",
        ),
        (
            {},
            {"schedule": {"weighting.log_temprature": anneal}},
            "there is no parameter 'weighting.log_temprature'.*weighting.log_temperature",
        ),
        (
            {},
            {"schedule": {"weighting.log_speed": lambda step: jnp.zeros(3)}},
            r"schedule of weighting.log_speed: returns \[3\], and the parameter is \[\]",
        ),
    ],
)
def test_what_would_not_be_used_is_refused(tmp_path, recipe, options, message):
    recipe = dataclasses.replace(SHORT, **recipe)
    with pytest.raises(InputError, match=message):
        nj.train(
            TRAINING,
            VALIDATION,
            tmp_path,
            config=SOFT,
            recipe=recipe,
            quiet=True,
            **options,
        )


TABLE = AnchorTableConfig(obs_len=4, pred_len=3, samples=3)
TABLE_RECIPE = nj.AnchorRecipe(steps=1, batch_scenes=4, validate_every=1, ema=0.0)


def branches(forecast, scene):
    """A loss that JAX cannot trace."""
    return forecast.mean() if forecast.mean() > 0 else -forecast.mean()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": lambda f, scene: None}, "one number for a scene, not NoneType"),
        ({"loss": lambda f, scene: (f.mean(), {})}, "for a scene, not tuple"),
        ({"loss": lambda f, scene: f.mean(axis=(1, 2, 3))}, r"a scene, not \[3\]"),
        ({"loss": lambda f, scene: f.argmax()}, "not int32, which has no gradient"),
        ({"loss": branches}, r"loss: .*custom.py:\d+: .*forecast.mean.* be traced"),
        ({"loss": lambda scene, f: scene.future}, "loss: .*custom.py.*AttributeError"),
        (
            {"schedule": {"params.moving": lambda step: None}},
            "schedule of params.moving: must return numbers, not NoneType",
        ),
        (
            {"schedule": {"params.moving": lambda step: jnp.nan}},
            "schedule of params.moving: is nan at step 0",
        ),
        (
            {"schedule": {"params.moving": lambda step: np.ones(9)[step]}},
            r"schedule of params.moving: .*custom.py:\d+: .* be traced by JAX",
        ),
        ({"optimizer": optax.contrib.sophia(0.1)}, "^optimizer: ValueError: obj_fn"),
        (
            {"optimizer": optax.stateless(lambda gradient, params: {})},
            "optimizer: update must return moves of all parameters",
        ),
        (
            {"optimizer": optax.GradientTransformation(dict, lambda g, s, p: g)},
            "optimizer: update must return moves and a state",
        ),
        (
            {"optimizer": optax.add_noise(0.1, 0.0, key=jax.random.key(0))},
            "optimizer: its state has a key of jax.random.key",
        ),
    ],
)
def test_own_code_that_fails_is_one_line_that_names_it(tmp_path, options, message):
    with pytest.raises(InputError, match=message) as caught:
        nj.train(
            TRAINING, VALIDATION, tmp_path, config=TABLE, recipe=TABLE_RECIPE,
            quiet=True, **options,
        )  # fmt: skip
    assert "\n" not in str(caught.value)


def test_neither_frozen_nor_scheduled_parameters_decay():
    decaying = optax.adamw(0.1, weight_decay=0.5)
    custom = make_custom(None, decaying, {"given": lambda step: 1 + step})
    changes = {"freeze": ("frozen",), "clip_norm": 0.0}
    recipe = custom.recipe(dataclasses.replace(TABLE_RECIPE, **changes))
    params = {name: jnp.ones(2) for name in ("free", "frozen", "given")}
    gradient = jax.tree.map(jnp.zeros_like, params)
    state = update(recipe, new_state(recipe, params), gradient)
    after = {name: float(state.params[name][0]) for name in params}
    assert after == {"free": pytest.approx(0.95), "frozen": 1.0, "given": 2.0}


@dataclasses.dataclass(frozen=True)
class MineConfig(nj.GeneratorConfig):
    """A configuration of its own."""


@pytest.mark.slow
def test_a_subclass_is_trained_by_its_own_loss(tmp_path):
    calls = []

    class Mine(GeneratorForecaster):
        Config = MineConfig

        def loss(self, params, batch, key, recipe):
            value, terms = super().loss(params, batch, key, recipe)
            calls.append(value)
            return 2 * value, terms | {"once": value}

    nj.register_forecaster("mine")(Mine)
    assert known_configs()["mine"] == MineConfig()
    config = MineConfig(**vars(GENERATOR))
    assert forecaster_of(config).model == "mine"
    recipe = dataclasses.replace(SHORT, steps=1)
    nj.train(TRAINING, VALIDATION, tmp_path, config=config, recipe=recipe, quiet=True)
    (row,) = map(json.loads, (tmp_path / "metrics.jsonl").read_text().splitlines())
    assert calls
    assert row["g_loss"] == pytest.approx(2 * row["once"])


def test_a_subclass_without_a_config_of_its_own_is_refused():
    class Mine(GeneratorForecaster):
        pass

    nj.register_forecaster("mine")(Mine)
    assert FORECASTERS["mine"] is Mine
    with pytest.raises(InputError, match="is the Config of generator and mine: give"):
        forecaster_of(GENERATOR)
