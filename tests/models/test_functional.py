"""The pure functions refuse other shapes and names when they are traced, in words."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models import Lengths
from neurosym_jax.models.forecaster import leaves_by_path, nested_parameters
from neurosym_jax.symbolic import (
    Cnd,
    Learned,
    Quantised,
    Soft,
    initial_parameters,
    make_weighting,
    observe,
    soft_alpha,
    soft_symbols,
)
from tests.models.test_strict import CONFIGS, WALKS, noise_of
from tests.networks import random_model

NOISE = np.ones((3, 2), np.float32)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            "SGAN",
            {"observed": WALKS[:, :3]},
            r"observed is \[3, 3, 2\], .* \[N, 4, 2\]",
        ),
        (
            "SGAN",
            {"observed": WALKS.swapaxes(0, 1)},
            r"observed is \[4, 3, 2\].*observed.swapaxes\(0, 1\)",
        ),
        ("SGAN", {"observed": WALKS[None]}, r"observed is \[1, 3, 4, 2\]"),
        ("SGAN", {"noise": NOISE[0]}, r"noise is \[2\], and the model takes \[k, 2\]"),
        ("SGAN", {"noise": NOISE[:, :1]}, r"noise is \[3, 1\], and .* \[k, 2\]"),
        ("SGAN", {"noise": None}, r"this forecaster needs one, \[k, 2\]"),
        ("SGAN", {"valid": np.ones(4, bool)}, r"valid is \[4\], not \[3\]"),
        ("SGAN", {"valid": np.ones(3)}, r"valid must be bool \[3\], not float"),
        ("SGAN", {"valid": np.ones(3, int)}, r"valid must be bool \[3\], not int"),
        ("anchors", {}, r"noise is \[3, 2\], and the model takes none"),
        ("SGAN", {"alpha": np.ones((3, 3, 4))}, "alpha: SGAN weights no pairs"),
        ("NeuroSyM", {"alpha": np.ones((3, 3))}, r"alpha is \[3, 3\], .*\[3, 3, 4\]"),
    ],
)
def test_other_shapes(name, change, message):
    model = random_model(CONFIGS[name])
    arguments = {"observed": WALKS, "noise": NOISE, **change}
    with pytest.raises(InputError, match=message):
        jax.eval_shape(lambda: nj.forecast(model.config, model.params, **arguments))


@pytest.mark.parametrize("name", CONFIGS)
def test_parameters_of_another_network(name):
    model = random_model(CONFIGS[name])
    noise = noise_of(model)
    flat = dict(leaves_by_path(model.params))
    last = [path for path in flat if not path.startswith("weighting")][-1]
    wider = nested_parameters({**flat, last: flat[last][..., None]})
    fewer = nested_parameters({path: flat[path] for path in flat if path != last})
    more = {**model.params, "wieghting": np.ones(81)}
    for params, message in [
        (wider, f"network: '{last}' is .*, 1\\), not "),
        (fewer, f"network: '{last}' is missing, not "),
        (more, r"network: 'wieghting' is \(81,\), not expected"),
        (list(flat.values()), "params must be those of a model.*, not list"),
    ]:
        with pytest.raises(InputError, match=message):
            nj.forecast(model.config, params, WALKS, noise)
    with pytest.raises(InputError, match="config is a Model"):
        nj.forecast(model, model.params, WALKS, noise)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SGAN", "NeuroSyM, soft", "anchors"])
def test_padding_may_hold_anything(name):
    model = random_model(CONFIGS[name])
    noise = noise_of(model)
    valid = np.array([True, False, True])

    def total(observed):
        forecast = nj.forecast(model.config, model.params, observed, noise, valid=valid)
        return jnp.where(valid[:, None, None], forecast, 0).sum()

    padded = np.where(valid[:, None, None], WALKS, np.float32(0))
    nothing = np.where(valid[:, None, None], WALKS, np.float32(np.nan))
    both = [jax.value_and_grad(total)(observed) for observed in (padded, nothing)]
    jax.tree.map(np.testing.assert_array_equal, *both)
    assert not np.any(both[0][1][1])


@pytest.mark.parametrize("name", ["SGAN", "anchors"])
@pytest.mark.parametrize(
    ("key", "message"),
    [
        (0, "key must be one, such as jax.random.key.0., not int"),
        (np.random.default_rng(0), "not Generator"),
        (jnp.ones(3), r"not float32 \[3\]"),
    ],
)
def test_what_is_no_key(name, key, message):
    forecaster = random_model(CONFIGS[name]).forecaster
    with pytest.raises(InputError, match=message):
        forecaster.init(key)
    jax.eval_shape(forecaster.init, jax.random.PRNGKey(0))


def test_a_key_is_no_seed():
    model = random_model(CONFIGS["SGAN"])
    with pytest.raises(InputError, match="seed must be a whole number, not Array"):
        nj.predict(model, WALKS, seed=jax.random.key(0))


def test_stacked_networks_are_refused_by_name():
    model = random_model(CONFIGS["SGAN"])
    stacked = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), model.params)
    networks = nj.Model(model.config, stacked)
    for predict in (
        lambda: nj.predict(networks, WALKS),
        lambda: nj.predict_scenes(networks, [WALKS]),
    ):
        with pytest.raises(InputError, match="params are those of another network"):
            predict()


@pytest.mark.parametrize(
    "call",
    [
        lambda folder: nj.save_model(random_model(CONFIGS["SGAN"]), folder),
        lambda folder: nj.predict("recommended", WALKS),
        lambda folder: list(nj.predict_batches([WALKS], "recommended")),
        lambda folder: nj.interop.export_model("recommended"),
        lambda folder: nj.interop.export_onnx("recommended"),
    ],
)
def test_a_name_is_no_model(call, tmp_path):
    with pytest.raises(InputError, match="model must be one, such as load_model"):
        call(tmp_path / "model")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda positions: 0, r"a function \(positions, valid, reach\).*: too many"),
        (lambda positions, valid: 0, "unexpected keyword argument 'reach'"),
        (lambda positions, valid, reach, slope: 0, "required argument: 'slope'"),
    ],
)
def test_a_weighting_of_other_arguments(function, message):
    with pytest.raises(InputError, match=message):
        nj.register_weighting("mine", reach=1.0)(function)


@pytest.mark.parametrize("register", [nj.register_weighting, nj.register_forecaster])
def test_a_component_without_a_name(register):
    with pytest.raises(InputError, match=r'needs a name: @register_\w+\("name"\)'):
        register(lambda positions, valid: 0)


def test_a_family_that_forgets_the_samples():
    @dataclasses.dataclass(frozen=True)
    class StillConfig(Lengths):
        pass

    class Still(nj.Forecaster):
        Config = StillConfig

        def forecast(self, params, scene, noise):
            return scene.observed[:, -1:] + jnp.zeros((self.pred_len, 1))

    nj.register_forecaster("still")(Still)
    model = nj.Model(StillConfig(obs_len=4, pred_len=3), {}, family="still")
    for forecast in (
        lambda: nj.forecast(model.config, {}, WALKS),
        lambda: nj.predict(model, WALKS),
    ):
        with pytest.raises(InputError, match=r"Still: forecast must return \[k, N"):
            forecast()


def test_a_configuration_without_lengths():
    class Lone:
        pass

    class Family(nj.Forecaster):
        Config = Lone

        def forecast(self, params, scene, noise):
            return scene.observed[None]

    nj.register_forecaster("lone")(Family)
    with pytest.raises(InputError, match="Lone lacks obs_len: make it a frozen"):
        nj.forecast(Lone(), {}, WALKS)


def test_a_stream_warns_once_and_names_the_scene(monkeypatch):
    monkeypatch.setattr("neurosym_jax.models.forecast.STREAMED", 2)
    model = random_model(CONFIGS["anchors"])
    jump = WALKS.copy()
    jump[1, 1] += 9.0
    with pytest.warns(InputWarning) as caught:
        list(nj.predict_batches([WALKS, jump, jump, jump], model, samples=3))
    (warning,) = caught
    assert str(warning.message).startswith("2 scenes: agents 1 of scene 1 have steps")


def test_whole_numbers_are_positions():
    model = random_model(CONFIGS["SGAN"])
    shape = jax.eval_shape(
        lambda: nj.forecast(model.config, model.params, WALKS.astype(int), NOISE)
    )
    assert (shape.shape, shape.dtype) == ((3, 3, 3, 2), np.float32)


@pytest.mark.parametrize(
    ("weighting", "parameters", "message"),
    [
        (
            Soft(learned=True),
            {"log_tempratur": 0.0},
            "has no parameter 'log_tempratur'",
        ),
        (Learned(), {}, "learned needs the parameter 'table'"),
        (
            Learned(),
            {"table": np.ones(80), "unobserved": 0.0},
            r"the parameter table of learned is \[80\], not \[81\]",
        ),
        (Cnd(), {"table": np.ones(81)}, "cnd has no parameter 'table'; it has none"),
    ],
)
def test_other_parameters_of_a_weighting(weighting, parameters, message):
    with pytest.raises(InputError, match=message):
        weighting.alpha(parameters, WALKS)


POINTS = WALKS[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: soft_symbols(POINTS, POINTS, temperature=0),
            "temperature must be positive, not 0",
        ),
        (
            lambda: soft_symbols(POINTS, POINTS, temperature=jnp.float32(-1)),
            "temperature must be positive, not -1",
        ),
        (
            lambda: soft_symbols(
                POINTS, POINTS, temperature=0.1, side_quantisation_factor=-1
            ),
            "side_quantisation_factor must be at least 0",
        ),
        (
            lambda: soft_symbols(POINTS.T, POINTS.T, temperature=0.1),
            r"positions must be \[..., T, 2\] of one length, not \[2, 4\]",
        ),
        (
            lambda: soft_alpha(observe(POINTS, POINTS)),
            r"probabilities must be \[..., 4, 3\] of symbols, not \[3, 4\]",
        ),
        (lambda: soft_alpha(np.ones((3, 4, 3)), np.ones(80)), r"not \[80\]"),
        (
            lambda: observe(POINTS, POINTS, quantisation_factor=np.float32(-1)),
            "quantisation_factor must be at least 0",
        ),
        (lambda: make_weighting("soft", period=0), "period must be positive, not 0"),
        (
            lambda: make_weighting("cnd")(WALKS, np.ones(3)),
            r"valid must be bool \[3\], not float32",
        ),
    ],
)
def test_other_arguments_of_symbols(call, message):
    with pytest.raises(InputError, match=message):
        call()


@pytest.mark.parametrize("weighting", [Soft(), Quantised()])
def test_a_speed_of_a_weighting_that_does_not_learn_may_be_traced(weighting):
    def alpha(speed):
        return weighting.alpha({"log_speed": jnp.log(speed)}, WALKS)

    shape = jax.eval_shape(jax.grad(lambda speed: alpha(speed).sum()), 0.1)
    assert shape.shape == ()
    given = initial_parameters(Learned())
    assert jax.eval_shape(lambda: Learned().alpha(given, WALKS)).shape == (3, 3, 4)


def test_a_stream_is_read_as_it_is_needed_and_equals_predict(monkeypatch):
    monkeypatch.setattr("neurosym_jax.models.forecast.STREAMED", 2)
    model, read = random_model(CONFIGS["SGAN"]), []

    def scenes():
        for number in range(5):
            read.append(number)
            yield WALKS[: 1 + number % 3]

    stream = nj.predict_batches(scenes(), model, samples=2)
    first = next(stream)
    assert read == [0, 1]
    forecasts = [first, *stream]
    assert read == [0, 1, 2, 3, 4]
    expected = nj.predict_scenes(model, list(scenes()), samples=2)
    for mine, other in zip(forecasts, expected, strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-6)


def test_padded_arrays_are_forecast_without_their_padding():
    model, rng = random_model(CONFIGS["SGAN"]), np.random.default_rng(0)
    padded = rng.normal(0, 1, (4, 3, *WALKS.shape[1:])).astype(np.float32)
    valid = np.array([[1, 1, 1], [1, 0, 1], [0, 0, 0], [0, 1, 0]], bool)
    padded[~valid] = np.nan
    forecasts = list(nj.predict_batches(padded, model, valid=valid, samples=2))
    assert nj.predict_scenes(model, iter(padded), valid=iter(valid), samples=2)
    assert [forecast.shape for forecast in forecasts] == [(2, 3, 3, 2)] * 4
    for number, (forecast, present) in enumerate(zip(forecasts, valid)):
        assert np.isnan(forecast[:, ~present]).all()
        if present.any():
            people = padded[number][present]
            expected = nj.predict(model, people, samples=2, frame=number)
            np.testing.assert_allclose(forecast[:, present], expected, atol=1e-6)
    # Without padding an array is a stream of scenes.
    (first,) = nj.predict_batches(padded[:1], model, samples=2)
    np.testing.assert_allclose(first, forecasts[0], atol=1e-6)


def test_masked_people_are_refused_and_masked_padding_is_padding():
    model = random_model(CONFIGS["SGAN"])
    valid = np.array([True, True, False])
    for agent in range(3):
        scene = np.ma.array(WALKS, mask=False)
        scene[agent, 0] = np.ma.masked
        if valid[agent]:
            with pytest.raises(InputError, match="some values are masked"):
                nj.predict_scenes(model, [scene], valid=[valid])
        else:
            (forecast,) = nj.predict_scenes(model, [scene], valid=[valid])
            assert np.isfinite(forecast[:, valid]).all()


@pytest.mark.parametrize(
    ("valid", "message"),
    [
        ([np.ones(2, bool)], r"valid of scene 0 must be bool \[3\], not bool \[2\]"),
        ([np.ones(3)], r"must be bool \[3\], not float64"),
        ([np.ones(3, bool)] * 2, "another length than the scenes, at 1"),
        ([], "another length than the scenes, at 0"),
    ],
)
def test_other_masks(valid, message):
    model = random_model(CONFIGS["SGAN"])
    with pytest.raises(InputError, match=message):
        list(nj.predict_batches([WALKS], model, valid=valid))


def test_an_argument_with_a_default_is_an_option_of_a_weighting():
    @nj.register_weighting("level", slope=0.5)
    def level(positions, valid, slope, height=2.0):
        agents, steps = positions.shape[:2]
        return jnp.full((agents, agents, steps), height * slope)

    weigh = nj.symbolic.make_weighting("level,height=3.0")
    assert float(weigh(WALKS)[0, 1, -1]) == 1.5
    with pytest.raises(InputError, match="height must be a finite number"):
        nj.symbolic.make_weighting("level,height=tall")


def test_an_export_names_the_line_that_needs_a_number_of_people():
    class CountedConfig(nj.models.ConstantVelocity.Config):
        pass

    class Counted(nj.models.ConstantVelocity):
        Config = CountedConfig

        def decode(self, params, context, scene, noise):
            return super().decode(params, context, scene, noise) * len(scene.valid)

    nj.register_forecaster("counted")(Counted)
    model = nj.Model(CountedConfig(), {}, family="counted")
    for export in (nj.interop.export_model, nj.interop.export_onnx):
        with pytest.raises(
            InputError, match=r"test_functional.py:\d+: .*len\(scene.valid"
        ):
            export(model)
