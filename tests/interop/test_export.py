"""Exported programs: one file, any number of people, the forecasts of `predict`."""

import jax
import numpy as np
import pytest

from neurosym_jax import GeneratorConfig, load_model, predict_representatives
from neurosym_jax.commands.export import run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.export import export_model
from neurosym_jax.models.forecaster import scene_noise
from neurosym_jax.scene import make_scene
from tests.networks import random_model
from tests.repository import ROOT, SMALL, exhaustive, run_python

pytest.importorskip("flatbuffers", reason="flatbuffers is not installed")
EXAMPLE = ROOT / "examples" / "run_exported.py"


def assert_same_forecasts(made, samples, peoples, rounded):
    """The program's forecasts are `predict`'s, to two units in the last place of metres."""
    program = jax.export.deserialize(bytearray(export_model(made, samples)))
    rng, spec, steps = (
        np.random.default_rng(1),
        made.forecaster.noise,
        made.config.obs_len,
    )
    for people in peoples:
        walks = rng.normal(0, 0.3, (people, 1, 2)) + rng.normal(
            0, 0.05, (people, steps, 2)
        )
        walks = rng.uniform(-2, 2, (people, 1, 2)) + np.cumsum(walks, axis=1)
        # Both subtract the same float32 numbers without rounding where these are of a
        # coarse grid.
        observed = (np.round(walks * 1024) / 1024 if rounded else walks).astype(
            np.float32
        )
        identity, slots = make_scene(observed).identity, people if spec.per_agent else 1
        noise = np.asarray(
            scene_noise(spec, jax.random.key(0), identity, samples, slots)
        )
        inputs = (
            [noise if spec.per_agent else noise.reshape(samples, -1)]
            if spec.dim
            else []
        )
        forecasts, probabilities = program.call(observed, *inputs)
        expected, likely = predict_representatives(made, observed, samples=samples)
        within = {"atol": 2e-6, "rtol": 3e-7} if rounded else {"atol": 2e-5}
        np.testing.assert_allclose(forecasts, expected, **within)
        np.testing.assert_allclose(probabilities, likely, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "mix"), [exhaustive("as_described", "global"), ("pool_net", "ped")]
)
def test_one_program_for_any_number_of_people(model, kind, mix):
    assert_same_forecasts(model(kind, mix), 5, (1, 7), rounded=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["recommended", exhaustive("neurosym_zara1_8")])
def test_shipped_models_for_1_2_7_and_64_people(name):
    assert_same_forecasts(load_model(name), 20, (1, 2, 7, 64), rounded=True)
    assert_same_forecasts(load_model(name), 20, (7,), rounded=False)


@pytest.mark.slow
def test_the_example_needs_nothing_of_ours(model, tmp_path, capsys):
    path = tmp_path / "model.stablehlo"
    path.write_bytes(export_model(model("pool_net"), 5))
    code = (
        f"import runpy, sys; sys.argv = ['run', {str(path)!r}]; "
        f"runpy.run_path({str(EXAMPLE)!r}, run_name='__main__'); "
        "assert not any(name.startswith('neurosym_jax') for name in sys.modules)"
    )
    assert run_python("-c", code).stdout == "5 futures of 3 people, 3 steps\n"


def test_the_command_and_what_is_refused(model, tmp_path, capsys):
    run(SMALL, tmp_path / "a.stablehlo", samples=3)
    assert "SGAN, no pooling, 3 forecasts" in capsys.readouterr().out
    program = jax.export.deserialize(bytearray((tmp_path / "a.stablehlo").read_bytes()))
    assert program.out_avals[0].shape[0] == 3
    with pytest.raises(InputError, match=r"a\.stablehlo: exists already"):
        run(SMALL, tmp_path / "a.stablehlo")
    with pytest.raises(InputError, match="samples must be at least 1"):
        export_model(model("pool_net"), 0)
    paired = GeneratorConfig(pooling="neurosym_ijcnn")
    with pytest.raises(InputError, match="forecasts in parity cases only"):
        export_model(random_model(paired))
