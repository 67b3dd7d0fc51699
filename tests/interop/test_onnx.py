"""ONNX models in ONNX Runtime: JAX's forecasts for any number of people and samples."""

# pyright: reportArgumentType=false

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax import GeneratorConfig, Model, load_model, predict, save_model
from neurosym_jax.commands.export import run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.export import export_onnx, program_of
from neurosym_jax.interop.onnx import to_onnx
from neurosym_jax.models.anchors.network import AnchorConfig
from neurosym_jax.models.disk import models_at_hand
from neurosym_jax.models.forecaster import Lengths
from tests.networks import random_model
from tests.repository import ROOT, SMALL, exhaustive, run_python

onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")
EXAMPLE = ROOT / "examples" / "run_onnx.py"
TOLERANCE = 1e-5
IN_CROWDS = 4e-5
"""Metres, of people who walk at random up to 20 m from the origin."""


def session_of(program):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(program, options)


def assert_same_forecasts(model, peoples, samples=20, crowd=0):
    """Those of the same program in JAX, of positions in metres near the origin.

    A `crowd` of so many people, who walk at random, is forecast as well.
    """
    session, spec = session_of(export_onnx(model, samples)), model.forecaster.noise
    program = jax.jit(program_of(model, samples))
    rng = np.random.default_rng(0)
    if crowd:
        steps = rng.normal(0, 1, (crowd, model.config.obs_len, 2))
        observed = rng.normal(0, 5, (crowd, 1, 2)) + steps.cumsum(axis=1)
        observed = observed.astype(np.float32)
        forecasts, _ = session.run(None, {"observed": observed})
        expected, _ = program(observed)
        np.testing.assert_allclose(forecasts, expected, rtol=0, atol=IN_CROWDS)
        # It subtracts the origin in float64.
        expected = predict(model, observed, samples=samples)
        np.testing.assert_allclose(forecasts, expected, rtol=0, atol=1e-4)
        # People who hardly move have no clear heading: docs/export.md.
        observed = observed[:, :1] + (0.05 * steps).cumsum(axis=1).astype(np.float32)
        forecasts, _ = session.run(None, {"observed": observed})
        expected = predict(model, observed, samples=samples)
        difference = np.abs(forecasts - expected).max(axis=(0, 2, 3))
        assert difference.max() < 3e-4
        assert np.mean(difference > 1e-4) < 0.02
    for people in peoples:
        walks = rng.normal(0, 3, (people, 1, 2)) + rng.normal(
            0, 0.4, (people, 1, 2)
        ) * np.arange(model.config.obs_len).reshape(1, -1, 1)
        observed = (walks + rng.normal(0, 0.05, walks.shape)).astype(np.float32)
        observed[-1, 2] += 9 * (people > 2)  # A tracking error, which is repaired.
        slots = (people,) if spec.per_agent else ()
        noise = rng.normal(size=(samples, *slots, spec.dim)).astype(np.float32)
        values = {"observed": observed} | ({"noise": noise} if spec.dim else {})
        forecasts, probabilities = session.run(None, values)
        expected, likely = program(*values.values())
        np.testing.assert_allclose(forecasts, expected, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(probabilities, likely, rtol=0, atol=TOLERANCE)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["recommended", exhaustive("neurosym_zara1_8")])
def test_shipped_models_for_1_2_7_and_64_people(name):
    crowd = 200 if name == "recommended" else 0
    assert_same_forecasts(load_model(name), (1, 2, 7, 64), crowd=crowd)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [name for name, _ in models_at_hand()])
def test_every_shipped_model(name):
    assert_same_forecasts(load_model(name), (1, 2, 7, 64))


SMALL_SIZES = {
    "obs_len": 4,
    "pred_len": 3,
    "embedding_dim": 4,
    "encoder_h_dim": 6,
    "mlp_dim": 8,
}
CONFIGS = {
    "no pooling": GeneratorConfig(**SMALL_SIZES, pooling="none"),
    "social pooling, noise per agent": GeneratorConfig(
        **SMALL_SIZES, pooling="social", noise_mix_type="ped"
    ),
    "soft, every step": GeneratorConfig(
        **SMALL_SIZES,
        pooling="as_described",
        weighting="soft",
        pool_every_timestep=True,
    ),
    "learned": GeneratorConfig(
        **SMALL_SIZES, pooling="neurosym_ros", weighting="learned"
    ),
    "anchors, symbols": AnchorConfig(
        obs_len=4, pred_len=3, samples=5, symbols=True, weighting="cnd"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        exhaustive(name) if name in ("no pooling", "learned") else name
        for name in CONFIGS
    ],
)
def test_networks_that_do_not_ship(name):
    model = random_model(CONFIGS[name], std=0.3)
    assert_same_forecasts(model, (1, 5), 5)


def test_operations_one_by_one():
    """What a later network may use: an output of each, beside jax, for two sizes of an axis."""
    table = np.random.default_rng(1).normal(size=(9, 3)).astype(np.float32)
    functions = {
        "rows of a table": lambda x: jnp.asarray(table)[
            jnp.clip(x[:, 0].astype(int), 0, 8)
        ],
        "elements": lambda x: jnp.take_along_axis(
            x, jnp.argmax(x, axis=1)[:, None], axis=1
        ),
        "pairs": lambda x: x[jnp.argmin(x, axis=0), jnp.arange(4)],
        "filled": lambda x: (
            jnp.asarray(table).at[x[:, 0].astype(int)].get(mode="fill", fill_value=7.0)
        ),
        "clipped": lambda x: jnp.clip(x, -0.5, jnp.float32(0.5)),
        "any and all": lambda x: (x > 0).any(axis=1) & ~(x > 1).all(axis=1),
        "booleans": lambda x: (x > 0) @ (x > 0).T,
        "reversed": lambda x: jnp.cumsum(x[:, ::-1], axis=1) + jnp.flip(x, 0),
        "padded": lambda x: jnp.pad(x, [(0, 0), (1, 2)], constant_values=3.0)[:, :-1],
        "unstacked": lambda x: jnp.unstack(x, axis=1)[1],
        "last rows": lambda x: x[-1] + x[:1],
        "a product of three axes": lambda x: jnp.einsum(
            "ni,nj,ij->ij", x, x, x[0][:, None] * x[0]
        ),
        "a loop over people": lambda x: jax.lax.scan(
            lambda c, r: (c + r, c * r), x[0], x
        )[1],
        "a loop backwards": lambda x: jax.lax.scan(
            lambda c, r: (c + r, c * r), x[0], x, reverse=True
        )[1],
        "a long loop over nothing": lambda x: jax.lax.fori_loop(
            0, 70, lambda _, c: 1 - c / 2, x
        ),
        "a mapping of steps": lambda x: jax.lax.map(lambda column: column.max(), x.T),
        "logarithms": lambda x: (
            jnp.log1p(jnp.abs(x)) + jnp.expm1(x) + jax.nn.softmax(x, axis=0)
        ),
        "finite": lambda x: jnp.where(jnp.isfinite(1 / (x - x[0])), x**3, -x),
        "signs": lambda x: jnp.sign(x).astype(jnp.int8) * jnp.arange(4, dtype=jnp.int8),
        "a constant": lambda x: jnp.zeros((2, 2)) + 3,
    }
    people = jax.export.symbolic_shape("people, 4")
    argument = jax.ShapeDtypeStruct(people, jnp.float32)
    rng = np.random.default_rng(0)

    def program(x):
        return tuple(function(x) for function in functions.values())

    session, in_jax = (
        session_of(to_onnx(program, {"x": argument}, [*functions], {})),
        jax.jit(program),
    )
    for count in (1, 6):
        x = rng.normal(0, 2, (count, 4)).astype(np.float32)
        for name, result, expected in zip(
            functions, session.run(None, {"x": x}), in_jax(x)
        ):
            assert result.shape == expected.shape, name
            np.testing.assert_allclose(
                result, expected, rtol=1e-5, atol=1e-5, err_msg=name
            )


def test_the_example_forecasts_a_file_without_jax(model, tmp_path):
    path, tracks = tmp_path / "model.onnx", tmp_path / "tracks.txt"
    path.write_bytes(export_onnx(model("pool_net")))
    steps = model("pool_net").config.obs_len + 2
    rows = [
        (10 * t, who, 1000.0 + 0.4 * t, who)
        for who, t in itertools.product((3, 8), range(steps))
    ]
    np.savetxt(tracks, [*rows, (0, 9, 5.0, 5.0)])  # The third person has gone.
    code = (
        f"import runpy, sys; sys.argv = ['run', {str(path)!r}, {str(tracks)!r}]; "
        f"runpy.run_path({str(EXAMPLE)!r}, run_name='__main__'); "
        "assert not {'jax', 'neurosym_jax'} & set(sys.modules)"
    )
    lines = run_python("-c", code).stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["3", "8"]
    assert all(" at 10" in line for line in lines)
    assert len(EXAMPLE.read_text().splitlines()) < 50


def test_the_command_and_what_is_refused(tmp_path, capsys, monkeypatch):
    run(SMALL, tmp_path / "a.onnx")
    assert "any number of forecasts of any number of people" in capsys.readouterr().out
    settings = (
        session_of((tmp_path / "a.onnx").read_bytes())
        .get_modelmeta()
        .custom_metadata_map
    )
    assert settings == {
        "model": "SGAN, no pooling",
        "period": "0.4",
        "noise": "gaussian",
    }
    still = Model(Lengths(), {}, family="constant_velocity")
    save_model(tmp_path / "still", still)
    run(tmp_path / "still", tmp_path / "still.onnx")
    assert "one forecast of any number of people" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"a\.onnx: exists already"):
        run(SMALL, tmp_path / "a.onnx")
    argument = {"x": jax.ShapeDtypeStruct((3,), jnp.float32)}
    with pytest.raises(InputError, match="ONNX: the operation sort has no translation"):
        to_onnx(lambda x: (jnp.sort(x),), argument, ["y"], {})
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(
        InputError, match=r"needs onnx: pip install 'neurosym-jax\[onnx\]'"
    ):
        run(SMALL, tmp_path / "b.onnx")
