import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread, imsave

from neurosym_jax import plotting
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.tables import labels
from neurosym_jax.plotting import (
    model_looks,
    plot_forecasts,
    plot_horizon_errors,
    save_figure,
)
from neurosym_jax.plotting.style import INK, PALETTE

MODELS = ("NeuroSyM (CND)", "SGAN", "constant velocity")


def walk(agents, steps=16, seed=0):
    """[agents, 8, 2] and [agents, steps - 8, 2] metres of people who walk or stand."""
    rng = np.random.default_rng(seed)
    speed = rng.normal(0, 0.4, (agents, 1, 2)) * (rng.random((agents, 1, 1)) > 0.2)
    path = rng.uniform(-8, 8, (agents, 1, 2)) + speed * np.arange(steps)[:, None]
    return path[:, :8], path[:, 8:]


def labelled(axes, label):
    """[lines, T, 2] of the lines with this label, which end at gaps."""
    paths = []
    for line in axes.lines:
        if line.get_label() == label:
            points = line.get_xydata()
            gap = np.isnan(points).all(axis=1)
            ends = np.flatnonzero(gap) - np.arange(gap.sum())
            paths += [path for path in np.split(points[~gap], ends) if len(path)]
    return paths


def legend_texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def assert_neat(figure, *data):
    """After a draw: legends lie in the figure and off the axes, and the data within the limits."""
    figure.draw_without_rendering()
    frame = figure.bbox
    for axes in figure.axes:
        assert axes._left_title.get_window_extent().x1 <= frame.x1 + 1
        place = figure.legends[0].get_window_extent()
        assert place.y1 <= axes.get_tightbbox().y0 + 1, "the legend lies on the axes"
        assert place.x1 <= frame.x1 + 1
        assert place.y0 >= frame.y0 - 1
        limits = np.transpose([axes.get_xlim(), axes.get_ylim()])
        for array in data:
            assert (limits[0] < array).all()
            assert (array < limits[1]).all()


@pytest.mark.parametrize("agents", [1, 60])
def test_forecasts_draw_every_agent_once_a_model(agents):
    observed, truth = walk(agents)
    forecasts = {name: truth + 0.3 * i for i, name in enumerate(MODELS)}
    figure = plot_forecasts(observed, truth, forecasts, "A title")
    (axes,), (legend,) = figure.axes, figure.legends
    assert legend_texts(figure) == ["start", "observed", "ground truth", *MODELS]
    assert [len(labelled(axes, label)) for label in legend_texts(figure)] == [
        agents
    ] * 6
    colours = [to_hex(line.get_color()).upper() for line in legend.get_lines()]
    assert colours == [
        INK,
        INK,
        INK,
        *(look["color"] for look in model_looks(MODELS).values()),
    ]
    own = [line for line in axes.lines if line.get_label() == "observed"][1:]
    assert [line.get_color() for line in own] == list(PALETTE[:agents])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert axes.get_title(loc="left") == "A title"
    assert axes.get_aspect() == 1
    expected = np.concatenate([observed[:, -1:], truth + 0.3], axis=1)
    np.testing.assert_array_equal(labelled(axes, "SGAN"), expected)
    assert_neat(figure, observed, truth, *forecasts.values())


def test_forecasts_of_one_model_have_the_colour_of_their_person():
    observed, truth = walk(3)
    axes = plot_forecasts(observed, truth, {"SGAN": truth[None] + 0.2}).axes[0]
    for label in ("observed", "ground truth", "SGAN, one guess", "SGAN, all 1"):
        lines = [line for line in axes.lines if line.get_label() == label][1:]
        assert [line.get_color() for line in lines] == list(PALETTE[:3])
        starts = [line.get_xdata()[0] for line in lines]
        assert starts == list(observed[:, 0 if label == "observed" else -1, 0])


def test_a_model_has_one_look():
    looks = model_looks(MODELS)
    assert looks == model_looks(reversed(MODELS))
    assert [look["linestyle"] for look in looks.values()] == [":", "-.", "--"]
    assert model_looks(["SGAN"]) == {"SGAN": looks["SGAN"]}
    names = ["neurosym a", "neurosym b", "sgan", "cv", "linear", "x", "y", "z"]
    for part in ("color", "linestyle"):
        assert len({look[part] for look in model_looks(names).values()}) == len(names)


def test_far_from_the_origin_without_truth_and_with_long_names():
    observed, truth = (track + np.array([5e5, 4.2e6]) for track in walk(4))
    title = "A long title that goes on and on, over the whole figure, and further still"
    names = [
        f"NeuroSyM with weights from fold_{i} of the $alpha$ ablation" for i in range(6)
    ]
    figure = plot_forecasts(observed, None, dict.fromkeys(names, truth), title)
    assert not labelled(figure.axes[0], "ground truth")
    assert_neat(figure, observed, truth)
    assert np.ptp(plot_forecasts(np.zeros((1, 8, 2)), None, {}).axes[0].get_xlim()) >= 3
    assert "e" not in "".join(t.get_text() for t in figure.axes[0].get_xticklabels())


def test_of_samples_the_one_of_least_joint_error_is_drawn():
    observed, truth = walk(3)
    samples = truth + np.array([1.0, 0.25, -0.5])[:, None, None, None] * [1, 0]
    axes = plot_forecasts(observed, truth, {"SGAN": samples}).axes[0]
    best = np.array(labelled(axes, "SGAN, best of 3"))
    np.testing.assert_array_equal(best[:, 1:], samples[1])
    assert len(labelled(axes, "SGAN, all 3")) == 9
    axes = plot_forecasts(observed, None, {"SGAN": samples}).axes[0]
    mean = np.array(labelled(axes, "SGAN, mean of 3"))
    np.testing.assert_allclose(mean[:, 1:], truth + np.array([0.25, 0]), atol=1e-9)


ERRORS = {"SGAN": [[0.2, 0.4], [0.1, 0.3], [0.4, 0.7]], "cv": [0.2, 0.8]}
STEPS = np.arange(400)
LOSSES = {
    "generator": (STEPS, 2.0 - STEPS / 400),
    "discriminator": ([0, 10], [1.4, np.nan]),
}
DRAWN = {
    # a figure, points of its lines, and its legend
    "errors by horizon": (
        lambda: plot_horizon_errors(ERRORS, 0.5, "errors"),
        {"SGAN": [[0.5, 0.2], [1.0, 0.4]], "cv": [[0.5, 0.2], [1.0, 0.8]]},
        ["cv", "SGAN"],  # The worst first.
    ),
    "training": (
        lambda: plotting.plot_training(LOSSES, {"ADE": ([0, 100], [0.8, 0.5])}, "run"),
        # The running mean of a straight line is that line, centred, without its ends.
        {"generator": np.stack([STEPS, 2.0 - STEPS / 400], 1)[10:-10]},
        ["generator", "discriminator", "ADE"],
    ),
}


@pytest.mark.parametrize("name", DRAWN)
def test_curves(name):
    make, curves, legend = DRAWN[name]
    figure = make()
    for label, points in curves.items():
        np.testing.assert_allclose(labelled(figure.axes[0], label), [points])
    assert legend_texts(figure) == legend
    assert_neat(figure)


def test_intervals_are_bands():
    axes = DRAWN["errors by horizon"][0]().axes[0]
    (band,) = axes.collections
    corners = {tuple(np.round(corner, 6)) for corner in band.get_paths()[0].vertices}
    assert corners == {(0.5, 0.1), (0.5, 0.4), (1.0, 0.3), (1.0, 0.7)}
    looks = [look["color"] for look in model_looks(["cv", "SGAN"]).values()]
    assert [line.get_color() for line in axes.lines] == looks


def test_files_have_the_kind_of_their_name_and_the_style(tmp_path):
    observed, truth = walk(2)
    before = dict(mpl.rcParams)
    figure = plot_forecasts(observed, truth, {"SGAN": truth})
    path = save_figure(figure, tmp_path / "new" / "folder" / "scene.png")
    image = imread(path)
    size = np.array(image.shape[1::-1]) / figure.get_size_inches()
    np.testing.assert_allclose(size, 220, atol=1)
    assert image[..., :3].std() > 0.02
    assert [file.name for file in path.parent.iterdir()] == ["scene.png"]
    pdf = save_figure(figure, tmp_path / "errors.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"/Type3" not in pdf
    assert "<svg" in save_figure(figure, tmp_path / "errors.SVG").read_text()
    with pytest.raises(
        InputError, match=r"errors.jpg: .* must end in .png, .pdf or .svg"
    ):
        save_figure(figure, tmp_path / "errors.jpg")
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("paths", "suffixes"),
    [
        (["a/x/1.pt", "a/y/1.pt"], ["x", "y"]),
        (["a/1.pt", "b/1.pt", "b/2.pt"], ["a/1.pt", "b/1.pt", "b/2.pt"]),
        (["m/1.pt", "a/2.pt"], ["1.pt", "2.pt"]),
        (["m/1.pt"], [""]),
    ],
)
def test_checkpoints_where_they_tell_models_apart(paths, suffixes):
    models = [("cv", None), *(("SGAN", path) for path in paths)]
    assert labels(models) == ["cv", *(f"SGAN {name}".strip() for name in suffixes)]


@pytest.mark.parametrize(
    ("people", "title"), [(5, "zara"), (6, "zara, 12 of 15 pairs")]
)
def test_the_title_says_how_many_pairs_are_left_out(people, title):
    recording = make_tracks(
        "zara", [0, 1] * people, np.arange(people).repeat(2), np.eye(2 * people, 2)
    )
    codes, alpha = np.zeros((people, people, 1), int), np.ones((people, people, 2))
    axes = plotting.plot_pairs(
        cut_windows([recording], 1, 1), codes, alpha, "zara"
    ).axes[1]
    assert axes.get_title("left") == f"QTC and alpha: {title}"
    assert len(axes.get_yticks()) == min(12, people * (people - 1) // 2)


@pytest.mark.parametrize("horizon", [0.02, -0.02])
def test_an_underlay_lies_where_its_homography_says(tmp_path, horizon):
    """A camera that looks along y, with a red pixel; nothing is drawn behind the camera.

    With the second homography rows from 50 on are above the horizon: sky is not drawn
    there either.
    """
    image, matrix = (
        np.full((80, 60, 3), 0.2),
        np.array([[0.1, 0, 0], [0, 0.1, 0], [0, horizon, 1]]),
    )
    image[40, 30] = 1, 0, 0
    imsave(tmp_path / "any.png", image)
    np.savetxt(tmp_path / "h.txt", matrix)
    floor = plotting.read_underlay(tmp_path / "any.png", tmp_path / "h.txt")
    x, y, depth = matrix @ [30, 40, 1]
    seen = [x / depth, y / depth]
    track = make_tracks("walk", [0, 1, 2], [1, 1, 1], [[0, -30], [6, 4], seen])
    (drawn,) = plotting.plot_tracks([track], floor).axes[0].images
    left, right, bottom, top = drawn.get_extent()
    red = np.argwhere(np.asarray(drawn.get_array())[..., 0] == 1).mean(axis=0)[::-1]
    scale = np.array([right - left, top - bottom]) / 699
    np.testing.assert_allclose([left, bottom] + scale * red, seen, atol=0.1)
    heights, alpha = np.linspace(bottom, top, 700), drawn.get_alpha()
    assert not alpha[heights < -0.1].any()
    assert (alpha[(heights > 0.1) & (heights < 3)] == 0.6).any()


def test_an_image_that_cannot_be_read_is_refused(tmp_path):
    np.savetxt(tmp_path / "h.txt", np.eye(3))
    with pytest.raises(InputError, match=r"h\.txt: cannot be read as an image"):
        plotting.read_underlay(tmp_path / "h.txt", tmp_path / "h.txt")


def test_a_talk_has_larger_letters_and_as_many_dots(tmp_path):
    paper = plot_horizon_errors({"a": [1, 2]})
    plotting.use_style("talk")
    try:
        talk = plot_horizon_errors({"a": [1, 2]})
    finally:
        plotting.use_style("paper")
    assert talk.get_figwidth() == pytest.approx(0.62 * paper.get_figwidth())
    dots = [figure.get_figwidth() * figure.get_dpi() for figure in (paper, talk)]
    assert dots[0] == pytest.approx(dots[1])
    sizes = [figure.axes[0].xaxis.label.get_size() for figure in (paper, talk)]
    assert sizes[0] == sizes[1]  # In points, of a smaller canvas.
    image = imread(save_figure(talk, tmp_path / "talk.png"))
    assert image.shape[1] == pytest.approx(dots[0], abs=2)


@pytest.mark.parametrize("people", [1, 2, 3, 9])
def test_each_persons_path_has_the_colour_of_its_beginning(people):
    """Two people had one: matplotlib took their colours for a colour and its opacity."""
    step, person = np.mgrid[:4, :people].reshape(2, -1)
    tracks = make_tracks("walk", step, person, np.stack([step, person], axis=1))
    paths, starts = plotting.plot_tracks([tracks]).axes[0].collections
    drawn = [to_hex(colour) for colour in paths.get_colors()]
    assert drawn == [to_hex(colour) for colour in starts.get_facecolors()]
    assert len(set(drawn)) == min(people, len(PALETTE))
