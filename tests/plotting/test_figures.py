import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from neurosym_jax.errors import InputError
from neurosym_jax.plotting import (
    line_styles,
    model_colours,
    plot_fan,
    plot_forecasts,
    plot_horizon_errors,
    plot_training,
    save_figure,
)
from neurosym_jax.plotting.palette import INK, TRUTH

MODELS = ("NeuroSyM (CND)", "SGAN", "constant velocity")


def walk(agents, steps=16, seed=0):
    """[agents, 8, 2] and [agents, steps - 8, 2] metres of people who walk or stand."""
    rng = np.random.default_rng(seed)
    speed = rng.normal(0, 0.4, (agents, 1, 2)) * (rng.random((agents, 1, 1)) > 0.2)
    path = rng.uniform(-8, 8, (agents, 1, 2)) + speed * np.arange(steps)[:, None]
    return path[:, :8], path[:, 8:]


def labelled(axes, label):
    return [line for line in axes.lines if line.get_label() == label]


def legend_texts(legend):
    return [text.get_text() for text in legend.get_texts()]


def assert_neat(figure, data=None):
    """After a draw: legends lie in the figure and off the axes, and the data within the limits."""
    figure.draw_without_rendering()
    frame = figure.bbox
    for axes in figure.axes:
        assert axes._left_title.get_window_extent().x1 <= frame.x1 + 1
        for legend in figure.legends:
            place = legend.get_window_extent()
            assert place.y1 <= axes.get_tightbbox().y0 + 1, "a legend lies on the axes"
            assert place.x1 <= frame.x1 + 1
            assert place.y0 >= frame.y0 - 1
        if data is not None:
            (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
            points = np.concatenate([np.reshape(array, (-1, 2)) for array in data])
            assert (points > [left, bottom]).all()
            assert (points < [right, top]).all()


@pytest.mark.parametrize("agents", [1, 6, 60])
def test_forecasts_draw_every_agent_once_a_model(agents):
    observed, truth = walk(agents)
    forecasts = {name: truth + 0.3 * i for i, name in enumerate(MODELS)}
    figure = plot_forecasts(observed, truth, forecasts, "A title")
    (axes,), (legend,) = figure.axes, figure.legends
    for label in ("start", "observed", "ground truth", *MODELS):
        assert len(labelled(axes, label)) == agents
    assert legend_texts(legend) == ["start", "observed", "ground truth", *MODELS]
    colours = [to_hex(line.get_color()).upper() for line in legend.get_lines()]
    assert colours == [INK, INK, TRUTH, *model_colours(MODELS).values()]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert axes.get_title(loc="left") == "A title"
    assert axes.get_aspect() == 1
    assert_neat(figure, [observed, truth, *forecasts.values()])


def test_a_line_holds_the_positions_and_joins_the_observation():
    observed, truth = walk(3)
    axes = plot_forecasts(observed, truth, {"SGAN": truth + 1}).axes[0]
    for agent, line in enumerate(labelled(axes, "SGAN")):
        expected = np.vstack([observed[agent, -1], truth[agent] + 1])
        np.testing.assert_array_equal(line.get_xydata(), expected)
    for agent, line in enumerate(labelled(axes, "start")):
        np.testing.assert_array_equal(line.get_xydata(), observed[agent, :1])
        assert line.get_marker() == "o"


def test_a_model_has_one_colour_in_every_figure():
    observed, truth = walk(6)
    colours = model_colours(MODELS)
    assert colours == model_colours(reversed(MODELS))
    for name in MODELS:
        drawn = [
            plot_forecasts(observed, truth, dict.fromkeys(MODELS, truth)),
            plot_horizon_errors({model: [0.1, 0.2] for model in MODELS}),
            plot_horizon_errors({name: [0.3]}),
            plot_fan(observed, truth, truth[None], name),
        ]
        found = {
            line.get_color()
            for figure in drawn
            for line in figure.axes[0].lines
            if line.get_label() == name or line.get_label().startswith("best of 1")
        }
        assert found == {colours[name]}


@pytest.mark.parametrize("looks", [line_styles, model_colours])
def test_models_of_one_kind_do_not_look_alike(looks):
    names = ["neurosym a", "neurosym b", "sgan", "cv", "linear", "x", "y", "z"]
    assert len(set(looks(names).values())) == len(names)
    assert len(looks(str(i) for i in range(30))) == 30
    if looks is line_styles:
        assert list(looks(MODELS).values()) == [":", "-.", "--"]


def test_standing_agents_are_shown_in_at_least_three_metres():
    figure = plot_forecasts(np.zeros((1, 8, 2)), None, {})
    axes = figure.axes[0]
    assert legend_texts(figure.legends[0]) == ["start", "observed"]
    assert np.ptp(axes.get_xlim()) >= 3
    assert np.ptp(axes.get_ylim()) >= 3
    assert_neat(figure, [np.zeros((1, 2))])


def test_far_from_the_origin_without_truth_and_with_long_names():
    observed, truth = (track + np.array([5e5, 4.2e6]) for track in walk(4))
    title = "A long title that goes on and on, over the whole figure, and further still"
    names = [f"NeuroSyM with weights from fold_{i} of the $alpha$ ablation" for i in range(6)]
    figure = plot_forecasts(observed, None, dict.fromkeys(names, truth), title)
    assert not labelled(figure.axes[0], "ground truth")
    assert_neat(figure, [observed, truth])
    assert "e" not in "".join(t.get_text() for t in figure.axes[0].get_xticklabels())


def test_fan_emphasises_the_sample_of_least_joint_error():
    observed, truth = walk(3)
    samples = truth + np.array([1.0, 0.25, -0.5])[:, None, None, None] * [1, 0]
    figure = plot_fan(observed, truth, samples, "fan")
    axes = figure.axes[0]
    assert len(labelled(axes, "samples")) == 9
    words = legend_texts(figure.legends[0])[-1].split()
    assert " ".join(words) == "best of 3, joint ADE 0.25 m"
    thick = [line for line in axes.lines if line.get_label().startswith("best")]
    assert len(thick) == 3
    np.testing.assert_array_equal(thick[2].get_xydata()[1:], samples[1, 2])
    assert thick[0].get_linewidth() > labelled(axes, "samples")[0].get_linewidth()
    assert_neat(figure, [observed, truth, samples])


def test_fan_without_truth_emphasises_the_mean():
    observed, truth = walk(2)
    samples = np.stack([truth - 1, truth + 2])
    figure = plot_fan(observed, None, samples)
    line = labelled(figure.axes[0], "mean of 2")[1]
    np.testing.assert_allclose(line.get_xydata()[1:], truth[1] + 0.5)
    assert_neat(figure, [observed, samples])


def test_horizon_errors_are_against_seconds_with_the_worst_first():
    figure = plot_horizon_errors({"SGAN": [0.1, 0.2, 0.4], "cv": [0.2, 0.5, 0.8]}, 0.5, "errors")
    axes = figure.axes[0]
    np.testing.assert_allclose(labelled(axes, "SGAN")[0].get_xdata(), [0.5, 1.0, 1.5])
    np.testing.assert_allclose(labelled(axes, "SGAN")[0].get_ydata(), [0.1, 0.2, 0.4])
    assert legend_texts(figure.legends[0]) == ["cv", "SGAN"]
    assert axes.get_xlim()[0] == axes.get_ylim()[0] == 0
    assert "[s]" in axes.get_xlabel()
    assert "[m]" in axes.get_ylabel()
    assert_neat(figure)


def test_training_has_a_panel_for_losses_and_one_for_validation():
    steps = np.arange(400)
    losses = {"generator": (steps, 2.0 - steps / 400), "discriminator": ([0, 10], [1.4, np.nan])}
    figure = plot_training(losses, {"ADE": ([0, 100], [0.8, 0.5])}, "run")
    upper, lower = figure.axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("loss", "validation error [m]")
    assert legend_texts(figure.legends[0]) == ["generator", "discriminator", "ADE"]
    # The running mean of a straight line is that line, centred, without its ends.
    (mean,) = labelled(upper, "generator")
    np.testing.assert_array_equal(mean.get_xdata(), steps[10:-10])
    np.testing.assert_allclose(mean.get_ydata(), 2.0 - steps[10:-10] / 400)
    assert_neat(figure)
    (alone,) = plot_training({}, {"ADE": ([0, 1], [0.8, 0.5])}).axes
    assert alone.get_ylabel() == "validation error [m]"


def test_a_png_has_its_size_and_is_not_blank(tmp_path):
    observed, truth = walk(2)
    figure = plot_forecasts(observed, truth, {"SGAN": truth})
    path = save_figure(figure, tmp_path / "new" / "folder" / "scene.png")
    image = imread(path)
    size = np.array(image.shape[1::-1]) / figure.get_size_inches()
    np.testing.assert_allclose(size, 220, atol=1)
    assert image[..., :3].std() > 0.02
    assert [file.name for file in path.parent.iterdir()] == ["scene.png"]


def test_a_figure_is_of_the_kind_that_its_name_says(tmp_path):
    figure = plot_horizon_errors({"SGAN": [0.1, 0.2]})
    pdf = save_figure(figure, tmp_path / "errors.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"/Type3" not in pdf
    assert mpl.rcParams["pdf.fonttype"] == 3
    assert "<svg" in save_figure(figure, tmp_path / "errors.SVG").read_text()
    with pytest.raises(InputError, match=r"errors.jpg: .* must end in .png, .pdf or .svg"):
        save_figure(figure, tmp_path / "errors.jpg")


def test_threads_draw_the_same_picture(tmp_path):
    observed, truth = walk(3)
    before = dict(mpl.rcParams)

    def draw(i):
        return save_figure(plot_fan(observed, truth, truth[None]), tmp_path / f"{i}.png")

    with ThreadPoolExecutor(2) as pool:
        images = [path.read_bytes() for path in pool.map(draw, range(4))]
    assert len(set(images)) == 1
    assert dict(mpl.rcParams) == before


def test_pyplot_is_never_imported():
    code = "from neurosym_jax.plotting import *; import sys; assert 'matplotlib' in sys.modules; "
    code += "sys.exit('matplotlib.pyplot' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


GOOD, NEXT = walk(2)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: plot_forecasts(GOOD[0], None, {}), "observed must be"),
        (lambda: plot_forecasts(np.zeros((0, 8, 2)), None, {}), "not empty"),
        (lambda: plot_forecasts(GOOD, NEXT[:1], {}), r"truth must be \[2, any, 2\]"),
        (lambda: plot_forecasts(GOOD, NEXT, {"m": NEXT[:, :3]}), r"forecast 'm' must be \[2, 8"),
        (lambda: plot_forecasts(GOOD, None, {"a": NEXT, "b": NEXT[:, 1:]}), "forecast 'b'"),
        (lambda: plot_forecasts(GOOD, NEXT, {"m": NEXT * np.nan}), "'m' holds .* not finite"),
        (lambda: plot_fan(GOOD, NEXT, NEXT), "samples must be"),
        (lambda: plot_fan(GOOD, NEXT, np.zeros((0, *NEXT.shape))), "not empty"),
        (lambda: plot_horizon_errors({}), "at least one model"),
        (lambda: plot_horizon_errors({"m": [0.1]}, period=0), "period"),
        (lambda: plot_horizon_errors({"m": [[0.1]]}), "errors 'm' must be"),
        (lambda: plot_training({}, {}), "neither"),
        (lambda: plot_training({"loss": ([1, 2], [0.5])}, {}), "'loss': steps and values"),
    ],
)
def test_bad_input_is_refused_in_words(call, words):
    with pytest.raises(InputError, match=words):
        call()
