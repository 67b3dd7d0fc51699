"""What callers pass on, by the number that reaches the user.

Each test stands for a mistake that a refactoring might make and that no test of a
formula notices: an argument dropped on the way, a default where a value was given, one
part of data taken for another. Expected numbers are computed here.
"""

import itertools
import math
import warnings

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.commands import train as train_command
from neurosym_jax.models.anchors.network import AnchorTableConfig
from neurosym_jax.models.anchors.training import AnchorRecipe
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.training.sweep import compare_sweep
from tests.repository import run_python
from tests.rows import write_sweep

STILL = Model(Lengths(4, 3), {}, None, "constant_velocity")


def walks(people, steps, period=0.4, speed=1.0, seed=0):
    """A table of people who walk in lines of their own, with a bend in each."""
    rng = np.random.default_rng(seed)
    person, frame = np.divmod(np.arange(people * steps), steps)
    rate, phase = rng.uniform([[0.5], [0]], [[3], [6]], (2, people))[:, person]
    bend = 0.5 * np.sin(rate * period * frame + phase)
    x = rng.uniform(-5, 5, people)[person] + speed * period * frame
    return pl.DataFrame(
        {"time": frame * period, "id": person, "x": x, "y": 2.0 * person + bend}
    )


def evaluated(model, table, **options):
    return nj.evaluate(model, table, baselines=(), **options).row(0, named=True)


def test_an_evaluation_has_the_steps_of_the_model():
    table = walks(2, 61, period=0.2)
    slow = Model(Lengths(4, 3, period=0.8), {}, None, "constant_velocity")
    # Of 12 s: 16 steps of 0.8 s, 31 of 0.4 s.
    assert [evaluated(model, table)["scenes"] for model in (slow, STILL)] == [
        16 - 6,
        31 - 6,
    ]


def test_intervals_count_blocks_of_whole_windows():
    row = evaluated(Model(Lengths(4, 3), {}, None, "constant_velocity"), walks(3, 41))
    assert (row["scenes"], row["blocks"]) == (
        35,
        len({start // 7 for start in range(35)}),
    )


@pytest.mark.parametrize("columns", [("scene",), ("camera",), ("scene", "camera")])
def test_each_column_of_recordings_counts(columns):
    """Two cameras of two scenes are four recordings, in which ids begin anew."""
    parts = []
    for number, values in enumerate(itertools.product("ab", repeat=len(columns))):
        named = [pl.lit(value).alias(name) for name, value in zip(columns, values)]
        parts.append(walks(2, 20, seed=number).with_columns(*named))
    recordings = nj.data.read_any(pl.concat(parts))
    assert len(recordings) == 2 ** len(columns)
    assert {len(tracks.id) for tracks in recordings} == {40}


def test_extras_do_not_look_ahead():
    extras = {"group": [5, 9, 9]}
    tracks = nj.data.make_tracks(
        "a", [0, 0.8, 1.2], [1, 1, 1], np.eye(3)[:, :2], extras
    )
    assert nj.data.resample(tracks, 0.4).extras["group"].tolist() == [5, 5, 9, 9]


def test_a_gap_of_many_steps_is_no_fast_step():
    """People go on 30 m away: after one step it is too fast, after ten it is a gap."""
    for missing, doubted in ((0, True), (9, False)):
        table = walks(2, 600, period=0.1)
        late = pl.col("time") > 30
        moved = table.with_columns(
            x=pl.when(late).then(pl.col("x") + 30).otherwise(pl.col("x")),
            time=pl.when(late)
            .then(pl.col("time") + 0.1 * missing)
            .otherwise(pl.col("time")),
        )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")  # also of a text that was said before
            nj.data.read_any(moved)
        messages = [str(warning.message) for warning in caught]
        assert any("faster than 10 m/s" in text for text in messages) == doubted, (
            messages
        )


def test_validation_is_of_the_validation_windows(tmp_path):
    """The score that chooses the state is the model's error on these, and not on the others."""
    learned = nj.windows_from(walks(4, 30, speed=1.0), 4, 3)
    validated = nj.windows_from(walks(4, 30, speed=3.0, seed=1), 4, 3)
    rows = []
    model = nj.train(
        learned,
        validated,
        tmp_path / "run",
        config=AnchorTableConfig(4, 3, samples=3),
        recipe=AnchorRecipe(steps=2, validate_every=1, batch_scenes=4, crowd_share=0.0),
        on_row=rows.append,
    )
    best = min(row["val_ade"] for row in rows)
    for windows, same in ((validated, True), (learned, False)):
        total = 0.0
        for first, last in itertools.pairwise(windows.bounds):
            scene = windows.position[first:last]
            futures = nj.predict(model, scene[:, :4], samples=3)
            errors = np.linalg.norm(futures - scene[:, 4:], axis=-1).mean(axis=-1)
            total += errors.sum(axis=1).min()
        assert (abs(total / windows.agents - best) < 1e-4) == same


def test_additional_recordings_have_the_steps_of_the_run(tmp_path):
    for name, period in (("walk", 0.4), ("check", 0.4), ("also", 0.2)):
        steps = int(12 / period)
        walks(3, steps, period, seed=ord(name[0])).write_csv(tmp_path / f"{name}.csv")
    options = train_command.Options(
        data=tmp_path, train_on=("walk",), validate_on=("check",),
        train_also=(tmp_path / "also.csv",), obs_len=4, pred_len=3,
    )  # fmt: skip
    training = train_command.make_run(options)[0].training
    moves = np.diff(training.position[..., 0], axis=1)
    np.testing.assert_allclose(moves, 0.4, atol=1e-6)
    assert len({reading.recording for reading in training.reading}) == 2


def sweep(folder, differences, frames=160):
    """A sweep of two models whose errors differ by `differences [seeds, frames]`."""
    runs = []
    for seed, difference in enumerate(differences):
        runs.append(("SGAN", "eth", seed, {"joint_ade": np.full(frames, 1.0)}))
        runs.append(("NeuroSyM", "eth", seed, {"joint_ade": 1.0 + difference}))
    write_sweep(folder, runs)
    compare_sweep(folder, "SGAN")
    return (
        pl.read_csv(folder / "report.csv").filter(metric="joint_ade").row(0, named=True)
    )


def test_a_comparison_knows_that_trainings_differ(tmp_path):
    """No scene differs from another, seeds do: Student's t of three numbers."""
    row = sweep(tmp_path, np.tile([[-0.1], [0.0], [0.1]], 160))
    half = 4.302653 * 0.1 / math.sqrt(3)
    assert [row["low_95"], row["high_95"]] == pytest.approx([-half, half], rel=1e-3)


def test_a_comparison_has_blocks_of_whole_windows(tmp_path):
    """Errors that go up and down by blocks of 16 frames have the interval of ten numbers."""
    signs = np.tile(np.repeat([1.0, -1.0], 16), 5)
    wide = sweep(tmp_path, np.tile(0.1 * signs, (3, 1)))
    (tmp_path / "other").mkdir()
    fine = sweep(
        tmp_path / "other",
        np.tile(0.1 * np.tile(np.repeat([1.0, -1.0], 8), 10), (3, 1)),
    )
    # Blocks of 8 would take the first for the second's like; of 16, the second has no
    # spread.
    assert wide["high_95"] - wide["low_95"] > 0.05
    assert fine["high_95"] - fine["low_95"] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_a_format_of_a_plugin_is_known_in_a_fresh_process(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "import neurosym_jax as nj\n"
        "class Mine(nj.data.Format):\n"
        "    title = 'mine'\n"
        "    uses = frozenset()\n"
        "    def knows(self, head):\n"
        "        return head.lines[0].startswith('MINE')\n"
        "    def read(self, path, options, frame_period):\n"
        "        time = np.arange(40) // 2 * 0.4\n"
        "        place = np.column_stack([time, np.arange(40) % 2 * 2.0])\n"
        "        return [nj.data.make_tracks('mine', time, np.arange(40) % 2, place)]\n"
        "nj.register_format('mine', Mine)\n"
    )
    (tmp_path / "a.dat").write_text("MINE\n")
    words = ("-m", "neurosym_jax", "inspect", "a.dat", "--plugin", "mine.py")
    done = run_python(*words, cwd=tmp_path, check=False, NEUROSYM_NO_CACHE="1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "mine" in done.stdout
    commands = done.stdout.split("next:\n")[1].splitlines()
    assert all(command.endswith(" --plugin mine.py") for command in commands)
