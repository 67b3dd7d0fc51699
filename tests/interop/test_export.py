"""Exported programs: one file, any number of people, the forecasts of `predict`."""

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from neurosym_jax import predict
from neurosym_jax.commands.export import Options, run
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.noise import scene_noise
from neurosym_jax.forecasting.parameters import nested_parameters
from neurosym_jax.interop.export import export_model
from neurosym_jax.scene import make_scene

pytest.importorskip("flatbuffers", reason="flatbuffers is not installed")
EXAMPLE = Path(__file__).parents[2] / "examples" / "run_exported.py"


def anchors():
    config = FORECASTERS["anchors"].Config(obs_len=4, pred_len=3)
    shapes, rng = FORECASTERS["anchors"](config).shapes(), np.random.default_rng(0)
    drawn = {name: rng.normal(0, 0.1, shape).astype("f") for name, shape in shapes.items()}
    return Model(config, nested_parameters(drawn), kind="anchors")


@pytest.mark.parametrize(
    ("kind", "mix"),
    [("as_described", "global"), ("pool_net", "ped"), ("anchors", None)],
)
def test_one_program_for_any_number_of_people(model, kind, mix):
    made = anchors() if kind == "anchors" else model(kind, mix)
    program = jax.export.deserialize(bytearray(export_model(made, 5)))
    rng, spec = np.random.default_rng(1), made.forecaster.noise
    for people in (1, 7):
        observed = np.cumsum(rng.normal(0, 0.2, (people, 4, 2)), axis=1).astype(np.float32)
        observed += rng.uniform(-1, 1, (people, 1, 2)).astype(np.float32)
        identity = make_scene(observed).identity
        slots = people if spec.per_agent else 1
        noise = np.asarray(scene_noise(spec, jax.random.key(0), identity, 5, slots))
        given = [noise if spec.per_agent else noise.reshape(5, -1)] if spec.dim else []
        forecasts, probabilities = program.call(observed, *given)
        np.testing.assert_allclose(forecasts, predict(made, observed, samples=5), atol=1e-6)
        assert probabilities.sum() == pytest.approx(1, abs=1e-6)
        assert (np.ptp(probabilities) > 1e-4) == (kind == "anchors")


def test_the_example_needs_nothing_of_ours(model, tmp_path, capsys):
    path = tmp_path / "model.stablehlo"
    path.write_bytes(export_model(model("pool_net"), 5))
    code = (
        f"import runpy, sys; sys.argv = ['run', {str(path)!r}]; "
        f"runpy.run_path({str(EXAMPLE)!r}, run_name='__main__'); "
        "assert not any(name.startswith('neurosym_jax') for name in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "5 futures of 3 people, 3 steps\n"


def test_the_command(tmp_path, capsys):
    small = Path(__file__).parents[1] / "golden" / "small.pt"
    run(Options(small, tmp_path / "a.stablehlo", samples=3))
    assert "SGAN, no pooling, 3 forecasts" in capsys.readouterr().out
    assert jax.export.deserialize(bytearray((tmp_path / "a.stablehlo").read_bytes())).in_avals
    with pytest.raises(InputError, match=r"a\.stablehlo: exists already"):
        run(Options(small, tmp_path / "a.stablehlo"))
    with pytest.raises(InputError, match="samples must be at least 1"):
        export_model(anchors(), 0)
