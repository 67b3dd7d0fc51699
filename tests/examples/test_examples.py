"""Every example, as a module, with fewer steps."""

import ast
import itertools
import re
import runpy
from types import SimpleNamespace

import numpy as np
import pytest

from neurosym_jax.scene import make_scene, pad_scene
from tests.repository import ROOT, exhaustive

FOLDER = ROOT / "examples"
TESTED = {
    *("which_pair_matters", "own_loop", "own_weighting", "closest"),
    *(
        "evaluate_tracks",
        "forecast_frames",
        "train_model",
        "weighting_gradient",
    ),
    "own_training",
    "own_network",
    "encounter_pooling",  # by tests/models/test_network_plugin.py
    "peer_forecasts",  # by tests/examples/test_peer_forecasts.py
    "run_exported",  # by tests/interop/test_export.py
    "run_onnx",  # by tests/interop/test_onnx.py
}


def example(name):
    return SimpleNamespace(**runpy.run_path(str(FOLDER / f"{name}.py"), run_name=name))


def test_no_example_is_forgotten():
    assert {path.stem for path in FOLDER.glob("*.py")} == TESTED


@pytest.mark.slow
def test_the_gradient_finds_the_pair_that_matters(capsys):
    foretold, largest = example("which_pair_matters").main()
    most = abs(foretold).argmax()
    assert abs(foretold[most]) > 1e-5
    np.testing.assert_allclose(foretold[most], largest[most], rtol=0.2)
    assert capsys.readouterr().out.count("by the gradient") == 12


@pytest.mark.slow
def test_a_training_of_ones_own(tmp_path):
    model = example("own_training").main(tmp_path, steps=2)
    kept = float(model.params["weighting"]["log_temperature"])
    assert kept == pytest.approx(np.log(0.2) + 2 / 300 * np.log(0.1), rel=1e-5)


@pytest.mark.slow
def test_a_network_of_ones_own_learns_from_symbols(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["own_network.py", "30"])
    example("own_network")
    errors, speed = capsys.readouterr().out.splitlines()
    own, straight = (float(text) for text in re.findall(r"[\d.]+(?= m\b)", errors))
    assert own < 0.9 * straight
    # It begins at 0.125 m/s.
    assert 0.05 < float(re.findall(r"[\d.]+", speed)[0]) < 0.3
    assert "0.125" not in speed


@pytest.mark.slow
def test_a_loop_of_ones_own(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["own_loop.py", "20"])
    example("own_loop")
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    first, last = (float(row[2]) for row in rows)
    assert last < first / 2
    assert all(
        abs(float(row[-1])) > 1e-3 for row in rows
    )  # The gradient by a symbol's weight.


@pytest.mark.slow
def test_a_weighting_of_ones_own_is_trained(monkeypatch):
    # The other is trained in the same way, and is the package's.
    assert example("own_weighting").main(steps=5, weightings=("nearness",)) != 1.0


@pytest.fixture(scope="module")
def tracks(tmp_path_factory):
    """Four people who cross each other's way for 16 s."""
    rows = [
        (
            10 * step,
            person,
            (-1) ** person * (0.4 * step - 8),
            0.7 * person + 0.01 * step,
        )
        for step, person in itertools.product(range(40), range(4))
    ]
    path = tmp_path_factory.mktemp("tracks") / "walk.txt"
    np.savetxt(path, rows, fmt=["%d", "%d", "%.4f", "%.4f"])
    return path


MODEL = ROOT / "checkpoints" / "sgan_simulations_8"
NUMBER, POSITIVE = r"([0-9.]+) *(?:± *[0-9.]+)? *", r"[0-9.]*[1-9][0-9.e-]*"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "prints"),
    [
        ("evaluate_tracks", ["TRACKS", MODEL], rf"\nSGAN +{NUMBER}{NUMBER}"),
        (
            "forecast_frames",
            ["TRACKS", MODEL],
            r"^2\.8 s: 4 people, samples \(20, 4, 8, 2\)\n",
        ),
        (
            "weighting_gradient",
            [],
            rf"log_speed: {POSITIVE}\n.* by log_temperature: {POSITIVE}\n",
        ),
        exhaustive("train_model", ["OUT", 2], "ADE"),
    ],
)
def test_a_script_of_ten_lines(
    name, arguments, prints, tracks, tmp_path, capsys, monkeypatch
):
    path, places = FOLDER / f"{name}.py", {"TRACKS": tracks, "OUT": tmp_path / "run"}
    body = ast.parse(path.read_text()).body[1:]
    nodes = itertools.chain(*map(ast.walk, body))
    lines = {node.lineno for node in nodes if hasattr(node, "lineno")}
    assert len(lines) <= 14, "imports and ten lines"
    words = [str(places.get(argument, argument)) for argument in arguments]
    monkeypatch.setattr("sys.argv", [str(path), *words])
    runpy.run_path(str(path), run_name="__main__")
    text = capsys.readouterr().out
    match = re.search(prints, text)
    assert match, text
    if name == "evaluate_tracks":
        assert 0 < float(match[1]) < float(match[2]) < 3
    assert name != "forecast_frames" or text.count("\n") == 40 - 7


def test_a_metric_of_ones_own():
    compute = example("closest").closest
    forecast = np.zeros((2, 3, 4, 2))
    forecast[:, 1, :, 0], forecast[1, 1, 2, 0] = 3.0, 1.0
    scene = pad_scene(make_scene(np.zeros((2, 2, 2))), 3)
    value, in_table = compute(forecast, scene)
    assert (value[:2].tolist(), in_table[:2].tolist()) == ([2.0, 2.0], [True, True])
    alone = make_scene(np.zeros((1, 2, 2)))
    assert not compute(forecast[:, :1], alone)[1].any()
