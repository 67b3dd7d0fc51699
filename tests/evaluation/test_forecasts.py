"""Forecasts of others: files and functions score as the same forecasts of a model do."""

import itertools
import json

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.commands.evaluate import Options, run
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.compare import baseline, make_test
from neurosym_jax.evaluation.forecasts import (
    read_csv_forecasts,
    read_forecasts,
    windows_of,
)
from neurosym_jax.evaluation.saved_forecasts import save_forecasts
from neurosym_jax.evaluation.scores import DRAWS

SAME = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde", "collision_rate")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Six people for 60 steps, ids from 11 and frames 10 apart from 780, as in ETH's files."""
    draw = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("recording") / "walk.txt"
    start = draw.uniform(0, 9, (6, 1, 2))
    xy = start + np.cumsum(draw.normal([0.4, 0.1], 0.1, (6, 60, 2)), axis=1)
    rows = []
    for step, person in itertools.product(range(60), range(6)):
        if step >= 5 * person:
            x, y = xy[person, step]
            rows.append(f"{780 + 10 * step}\t{11 + person}\t{x:.4f}\t{y:.4f}")
    path.write_text("\n".join(rows) + "\n")
    return path


def straight_on(path, steps=8):
    """Constant velocity of all windows of a recording, from its text alone: arrays of a file."""
    table = np.loadtxt(path)
    place = {(int(frame), int(person)): xy for frame, person, *xy in table}
    ids, frames, samples = [], [], []
    for frame in np.unique(table[:, 0]).astype(int):
        window = [frame + 10 * step for step in range(-7, steps + 1)]
        people = []
        for person in range(11, 17):
            if all((at, person) in place for at in window):
                people.append(person)
        for person in people if len(people) > 1 else []:
            last, before = (np.array(place[at, person]) for at in (frame, frame - 10))
            ids.append(person)
            frames.append(frame)
            samples.append([last + n * (last - before) for n in range(1, steps + 1)])
    return {
        "samples": np.array(samples)[None],
        "ids": np.array(ids),
        "frames": np.array(frames),
    }


@pytest.fixture(scope="module")
def file(recording):
    path = recording.with_name("mine.npz")
    np.savez(path, **straight_on(recording))
    return path


def errors(rows, model):
    (row,) = rows.filter(model=model).to_dicts()
    return [row[name] for name in SAME]


def test_a_file_scores_as_the_model_that_it_is_of(recording, file):
    options = {"baselines": ["constant_velocity", "constant_velocity_sampled"]}
    rows = nj.evaluate((), recording, forecasts=file, **options)
    assert errors(rows, "mine") == pytest.approx(
        errors(rows, "constant velocity"), abs=1e-5
    )
    mine = rows.filter(model="mine").row(0, named=True)
    assert (mine["scenes"], mine["samples"], mine["latency"]) == (
        rows["scenes"][0],
        1,
        None,
    )
    assert mine["joint_ade_low"] < mine["joint_ade"] < mine["joint_ade_high"]
    # Paired tests take it in: of two equal ones none is the best.
    assert (rows["marginal_ade_p"] == 1).sum() == 1 or rows[
        "marginal_ade_p"
    ].null_count() == 1
    table = nj.evaluation.format_table(rows)
    assert next(line for line in table.splitlines() if line.startswith("mine"))


def test_rows_in_any_order_and_names_by_mapping(recording, file, tmp_path):
    arrays = dict(np.load(file))
    order = np.random.default_rng(0).permutation(len(arrays["ids"]))
    shuffled = {
        name: array[:, order] if name == "samples" else array[order]
        for name, array in arrays.items()
    }
    np.savez(tmp_path / "mine.npz", **shuffled)
    files = {"one": file, "other": tmp_path / "mine.npz"}
    rows = nj.evaluate((), recording, forecasts=files, baselines=[])
    assert rows["model"].to_list() == ["one", "other"]
    assert errors(rows, "one") == errors(rows, "other")
    rows = nj.evaluate((), recording, forecasts=list(files.values()), baselines=[])
    assert sorted(rows["model"].to_list()) == sorted(
        {f"{path.parent.name}" for path in files.values()}
    )


@pytest.mark.slow
def test_functions_of_numpy_and_torch_score_as_a_model_does(recording):
    torch = pytest.importorskip("torch")

    def stay(observed):
        return np.repeat(observed[:, -1:], 8, axis=1)

    def weighted(observed):
        tensor = torch.tensor(observed, requires_grad=True)
        velocity = tensor[:, -1:] - tensor[:, -2:-1]
        ahead = tensor[:, -1:] + velocity * torch.arange(1, 9)[:, None]
        return torch.stack([ahead, ahead + 99]), torch.tensor([0.9, 0.1])

    calls = itertools.count()

    def sometimes(observed):
        samples = stay(observed)[None]
        return (samples, [1 - 1e-17]) if next(calls) % 2 else samples

    options = {
        "baselines": "constant_velocity",
        "metrics": [*SAME, "central_ade", "neighbour_move"],
    }
    rows = nj.evaluate(
        [stay, weighted, lambda observed: stay(observed)], recording, **options
    )
    assert rows["model"].to_list() == [
        "constant velocity",
        "stay",
        "weighted 1",
        "lambda 2",
    ]
    assert errors(rows, "weighted 1")[:4] == pytest.approx(
        errors(rows, "constant velocity")[:4], abs=1e-5
    )
    central = dict(zip(rows["model"], rows["central_ade"]))
    assert central["weighted 1"] == pytest.approx(
        central["constant velocity"], abs=1e-5
    )
    assert errors(rows, "stay") == errors(rows, "lambda 2")
    assert rows["latency"][1] > 0
    assert rows["neighbour_move"][0] == 0
    assert rows["neighbour_move"][1] is None  # Nobody was forecast alone.
    for wrong, message in (
        (lambda observed: observed[:, 1:], r"must return finite \[\d, 8, 2\] or"),
        (lambda observed: stay(observed) * np.nan, "must return finite"),
        (lambda observed: None, "must return finite"),
        (lambda observed: (stay(observed)[None], [0.5]), "sum of 1"),
        (lambda observed: (np.stack(3 * [stay(observed)]), [1.5, -0.5, 0]), "negative"),
        (sometimes, r"probabilities of \d+ of \d+ scenes"),
        ("constant", "is no model or function: str"),
    ):
        with pytest.raises(InputError, match=message):
            nj.evaluate([wrong], recording, **options)


def changed(file, tmp_path, **arrays):
    path = tmp_path / "changed.npz"
    np.savez(path, **{**np.load(file), **arrays})
    return path


def test_what_does_not_match_is_refused_with_counts(recording, file, tmp_path):
    arrays = dict(np.load(file))
    count = len(arrays["ids"])

    def refused(message, **changes):
        path = changed(file, tmp_path, **changes)
        with pytest.raises(InputError, match=message):
            nj.evaluate((), recording, forecasts=path, baselines=[], pred_len=8)

    refused(
        rf"{count} of {count} people .* and {count} of {count} fore",
        ids=arrays["ids"] + 99,
    )
    refused(
        rf"6 of {count} people .* begin with frame 900,", frames=arrays["frames"] - 10
    )
    for shift, words in ((-10, "later"), (10, "earlier")):
        path = changed(file, tmp_path, frames=arrays["frames"] + shift)
        with pytest.warns(InputWarning, match=f"fit what happened a step {words}"):
            nj.evaluate((), recording, forecasts=path, baselines=[], partial=True)
    less = {
        name: array[..., 2:, :, :] if name == "samples" else array[2:]
        for name, array in arrays.items()
    }
    refused(
        rf"2 of {count} people in windows have no forecast, and 0 of {count - 2} fore",
        **less,
    )
    twice = {
        name: np.concatenate(
            [array, array[:, :1] if name == "samples" else array[:1]], axis
        )
        for (name, array), axis in zip(arrays.items(), (1, 0, 0))
    }
    refused("1 rows repeat a recording, frame and id", **twice)
    refused(
        r"begin \d+\.\d m from people's last positions", samples=arrays["samples"] + 50
    )
    refused("forecasts of 5 steps", samples=arrays["samples"][:, :, :5])
    refused("samples must be", samples=arrays["samples"][0])
    refused("ids must be", ids=arrays["ids"][1:])
    refused(
        "samples of 1 of",
        samples=np.where(
            np.arange(count)[:, None, None] == 3, np.nan, arrays["samples"]
        ),
    )
    infinite = arrays["samples"].copy()
    infinite[0, 3, 5, 1] = np.inf
    refused("samples of 1 of", samples=infinite)
    refused("have a sum of 1", probabilities=np.full(1, 0.5))
    refused("recordings elsewhere", recordings=np.full(count, "elsewhere"))
    doubled = {"samples": np.repeat(arrays["samples"], 2, axis=0)}
    uneven = np.array([np.linspace(0.1, 0.9, count), np.linspace(0.9, 0.1, count)])
    refused("are not those of others in their scene", probabilities=uneven, **doubled)
    negative = np.array([1.5, -0.5])
    refused("must not be negative", probabilities=negative, **doubled)
    np.savez(tmp_path / "less.npz", samples=arrays["samples"])
    for path, message in (
        (tmp_path / "less.npz", "array 'ids' is missing"),
        (recording, "cannot be read as .npz, .csv or .ndjson"),
        (tmp_path / "none.npz", "cannot be read"),
    ):
        with pytest.raises(InputError, match=message):
            read_forecasts(path)


def test_partial_files_are_tested_on_the_windows_that_all_have(
    recording, file, tmp_path
):
    arrays = dict(np.load(file))
    late = arrays["frames"] > 1000
    path = changed(
        file,
        tmp_path,
        samples=arrays["samples"][:, late],
        ids=arrays["ids"][late],
        frames=arrays["frames"][late],
    )
    options = {
        "forecasts": [path, file],
        "baselines": ["constant_velocity"],
        "partial": True,
    }
    rows = nj.evaluate((), recording, **options)
    assert set(rows["agents"]) == {int(late.sum())}
    assert errors(rows, "changed") == pytest.approx(
        errors(rows, "constant velocity"), abs=1e-5
    )
    assert errors(rows, "changed") == errors(rows, "mine")


@pytest.mark.slow
def test_what_we_save_is_read_and_can_stand_alone(recording, tmp_path, capsys):
    """By the command: forecasts that it wrote, beside their model and without the recording."""
    where = {"json": tmp_path / "rows.json", "figures": False, "samples": 3}
    saved = tmp_path / "saved.npz"
    data = {"data": recording, "baselines": ("constant_velocity_sampled",)}
    model = {"model": ("anchor_table_general_8",)}
    first = run(Options(**where, **data, **model, save_forecasts=saved))
    files = tuple(sorted(tmp_path.glob("saved_*.npz")))
    assert len(files) == 2
    label = (f"ours={files[0]}",)
    metrics = ("energy_score", "central_ade")
    rows = run(
        Options(**where, **data, **model, forecasts=files, label=label, metrics=metrics)
    )
    named = {row["model"]: row for row in rows}
    assert list(named)[2:] == ["ours", files[1].stem]
    for name, model_name in zip(
        list(named)[2:], ("anchor table", "constant velocity, sampled")
    ):
        for metric in (*SAME[:4], "central_ade"):
            assert named[name][metric] == pytest.approx(
                named[model_name][metric], abs=2e-4
            )
        # A file has no other draws than its samples.
        assert (named[name]["draws"], named[model_name]["draws"]) == (3, DRAWS)
    by_three, by_draws = (
        named[name]["energy_score"]
        for name in (files[1].stem, "constant velocity, sampled")
    )
    assert by_three == pytest.approx(by_draws, rel=0.05)  # Unbiased.
    alone = run(
        Options(**where, forecasts=files, baselines=("constant_velocity_sampled",))
    )
    assert [row["dataset"] for row in alone] == ["walk"] * 3
    assert alone[1]["joint_ade"] == pytest.approx(first[1]["joint_ade"], abs=2e-4)
    report = json.loads((tmp_path / "rows.json").read_text())
    assert {str(path) for path in files} <= report["provenance"]["checkpoints"].keys()
    capsys.readouterr()
    for options, message in (
        ({"label": ("x=y",)}, "--label x=y: NAME=PATH, of one of these paths"),
        ({"partial": True, "forecasts": ()}, "--partial"),
        ({"obs_len": 3}, "obs_len: has no effect on windows of a file"),
        ({"read": ReadOptions(unit="mm")}, "unit: has no effect on windows of a file"),
    ):
        with pytest.raises(InputError, match=message):
            run(Options(**where | {"forecasts": files} | options))
    for options in ({"period": 0.8}, {"min_agents": 9}, {"unit": "mm"}):
        with pytest.raises(InputError, match="has no effect on windows of a file"):
            nj.evaluate(forecasts=files, **options)


def test_csv_has_the_forecasts_that_are_saved(recording, tmp_path):
    """In any order of rows, and with the columns that it needs alone."""
    entries = [(None, baseline("anchor_table", 8, 8))]
    test = make_test(Case("walk", 8, 8), entries, nj.data.read_any(recording))
    path, other = tmp_path / "saved.csv", tmp_path / "saved.npz"
    save_forecasts(path, [test], 3, 0)
    save_forecasts(other, [test], 3, 0)
    table = pl.read_csv(path)
    assert table.row(1, named=True)["seconds"] == pytest.approx(0.8)
    shuffled = table.sample(fraction=1.0, shuffle=True, seed=0)
    shuffled.write_csv(tmp_path / "shuffled.csv")
    found, truth = read_forecasts(tmp_path / "shuffled.csv"), read_forecasts(other)
    order = np.lexsort((found.ids, found.frames))
    own = np.lexsort((truth.ids, truth.frames))
    np.testing.assert_array_equal(found.samples[:, order], truth.samples[:, own])
    np.testing.assert_allclose(
        found.probabilities[:, order], truth.probabilities[:, own], atol=1e-6
    )
    options = {"baselines": [], "pred_len": 8}
    rows = nj.evaluate((), recording, forecasts=[path, other], **options)
    assert errors(rows, "saved.csv") == errors(rows, "saved.npz")

    few = table.filter(pl.col("sample") == 0).select("frame", "id", "step", "x", "y")
    few.write_csv(tmp_path / "few.csv")
    assert read_forecasts(tmp_path / "few.csv").samples.shape[0] == 1
    for damaged, message in (
        (few.drop("step"), "column 'step' is missing"),
        (few[1:], "rows, not each of 8 steps of 1 samples"),
        (pl.concat([few[1:], few[1:2]]), "once"),
        (few.with_columns(x=pl.lit("a")), r"few\.csv: cannot be read as"),
        (few.with_columns(x=pl.lit(float("inf"))), "are not finite"),
        (few[:0], "has no rows"),
        (few.with_columns(pl.col("step") - 1), "steps must be 1, 2, .*, not 0, 1"),
        (few.with_columns(pl.col("step") * 2), "steps must be 1, 2, .*, not 2, 4"),
        (
            few.with_columns(probability=pl.col("step") / 8),
            "the probability of a sample differs between steps",
        ),
    ):
        damaged.write_csv(tmp_path / "few.csv")
        with pytest.raises(InputError, match=message):
            read_forecasts(tmp_path / "few.csv")


def test_people_whose_ids_are_texts_keep_them(recording, file, tmp_path):
    names = np.array(["anna", "Ben", "7", "$x$", "p 1", "zoë"])
    table = np.loadtxt(recording)
    ids = names[table[:, 1].astype(int) - 11]
    frame = pl.DataFrame(
        {"frame": table[:, 0], "id": ids, "x": table[:, 2], "y": table[:, 3]}
    )
    frame.write_csv(tmp_path / "walk.csv")
    arrays = dict(np.load(file))
    windows = nj.windows_from(tmp_path / "walk.csv", 8, 8, read=ReadOptions(fps=25))
    assert set(windows.agent) == set(names)
    np.savez(tmp_path / "texts.npz", **arrays | {"ids": names[arrays["ids"] - 11]})
    data, read = tmp_path / "walk.csv", ReadOptions(fps=25)
    rows = nj.evaluate(
        (), data, forecasts=tmp_path / "texts.npz", baselines=[], pred_len=8, fps=25
    )
    numbered = nj.evaluate((), recording, forecasts=file, baselines=[], pred_len=8)
    assert errors(rows, "texts") == pytest.approx(errors(numbered, "mine"))

    entries = [(None, baseline("constant_velocity", 8, 8))]
    test = make_test(Case("walk", 8, 8), entries, nj.data.read_any(data, read))
    for ending in (".ndjson", ".csv", ".npz"):
        path = tmp_path / f"saved{ending}"
        save_forecasts(path, [test], 1, 0)
    arrays = read_csv_forecasts(tmp_path / "saved.csv")
    assert arrays["ids"].tolist() == windows.agent.tolist()
    with np.load(path) as arrays:
        assert arrays["ids"].tolist() == windows.agent.tolist()
    rows = nj.evaluate(forecasts=path, baselines=["constant_velocity"])
    ours, straight = (row["joint_ade"] for row in rows.to_dicts())
    assert ours == pytest.approx(straight, abs=1e-4)


def test_the_windows_of_a_file_alone_are_named_in_order_and_have_any_samples(
    file, tmp_path
):
    arrays = dict(np.load(file))
    count = len(arrays["ids"])
    names = np.array([f"hall{number}" for number in range(5, 0, -1)])
    path = changed(
        file,
        tmp_path,
        recordings=np.repeat(names, -(-count // 5))[:count],
        observed=np.repeat(arrays["samples"][0, :, :1], 8, axis=1),
        truth=arrays["samples"][0],
        scene=np.arange(count),
        start=np.arange(count),
        period=0.8,
    )
    assert windows_of(read_forecasts(path)).period == 0.8
    # The anchor table, which has 20, is no baseline then.
    rows = nj.evaluate(forecasts=path, samples=21)
    assert set(rows["dataset"]) == {"hall1+hall2+hall3+hall4+hall5"}


def test_a_file_without_what_happened_needs_recordings(file, tmp_path):
    options = {"json": tmp_path / "rows.json", "figures": False, "baselines": ()}
    with pytest.raises(
        InputError, match=r"mine.npz: does not hold what happened \('observed'\)"
    ):
        run(Options(**options, forecasts=(file,)))


def test_figures_draw_forecasts_of_files(recording, file, tmp_path):
    options = {"json": tmp_path / "rows.json", "plots": tmp_path / "figures"}
    rows = run(Options(**options, data=recording, forecasts=(file,), baselines=()))
    assert [row["model"] for row in rows] == ["mine"]
    assert len(list((tmp_path / "figures").iterdir())) == 1


def test_several_recordings_need_names(recording, file, tmp_path):
    other = tmp_path / "other.txt"
    other.write_text(recording.read_text())
    recordings = [recording, other]
    with pytest.raises(InputError, match="has no `recordings`, and the test set has 2"):
        nj.evaluate((), recordings, forecasts=file, baselines=[])
    arrays = dict(np.load(file))
    count = len(arrays["ids"])
    named = {
        "samples": np.concatenate([arrays["samples"], arrays["samples"] + 0.5], axis=1),
        "ids": np.tile(arrays["ids"], 2),
        "frames": np.tile(arrays["frames"], 2),
        "recordings": np.repeat(["walk", "other"], count),
    }
    path = changed(file, tmp_path, **named)
    rows = nj.evaluate((), recordings, forecasts=path, baselines=["constant_velocity"])
    alone_first = nj.evaluate((), recording, forecasts=file, baselines=[])
    moved = changed(file, tmp_path, samples=arrays["samples"] + 0.5)
    alone_second = nj.evaluate((), other, forecasts=moved, baselines=[])
    mean = (errors(alone_first, "mine")[0] + errors(alone_second, "changed")[0]) / 2
    assert errors(rows, "changed")[0] == pytest.approx(mean)
    assert isinstance(rows, pl.DataFrame)
