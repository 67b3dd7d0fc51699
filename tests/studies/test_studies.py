"""Studies that are short: their pages are what they print, and their mistakes are noticed."""

import contextlib
import io
import json
import re
import runpy
from unittest import mock

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
import pytest

from neurosym_jax.data.recordings import read_any
from neurosym_jax.errors import InputError
from studies import place, results
from studies.distribution import table as distribution_table
from studies.mistakes.__main__ import tell
from studies.mistakes.corpus import MISTAKES
from studies.more_data import (
    HERMES,
    KEPT_BACK,
    LEARNED,
    STANFORD,
    STANFORD_TESTED,
    TESTED,
    write,
)
from studies.notebooks import FOLDER
from tests.repository import ROOT, exhaustive

DOCS = ROOT / "docs"
DOWNLOADED = {"an_overtaking_ahead_of_time": "eth-ucy"}
"""Notebooks of real recordings, and the collection that they are of."""
LONG = {"your_weighting", "gradient_through_a_symbol", "your_network", "fine_tuning"}
LONG |= {"two_models_compared", "a_papers_table", "calibrate_online", "torch_and_here"}
"""Notebooks that run for a release: other tests call their functions in every run."""
NEEDS = {"torch_and_here": "torch"}


def run_module(name, *words):
    """`python -m NAME WORDS` in this process."""
    with mock.patch("sys.argv", [name, *map(str, words)]):
        runpy.run_module(name, run_name="__main__")


def test_the_results_are_what_their_study_writes(tmp_path):
    rows = (DOCS / "results.json", DOCS / "results_joint_metrics.json")
    run_module("studies.results", *rows, tmp_path)
    for name in ("results.md", "results.csv"):
        assert (tmp_path / name).read_text(encoding="utf-8") == (DOCS / name).read_text(
            "utf-8"
        )


def test_the_lead_without_two_data_sets_is_that_of_the_table():
    rows = pl.read_csv(DOCS / "results.csv").filter(
        (pl.col("steps") == "8 + 12") & (pl.col("metric") == "joint ADE / FDE")
    )
    means = []
    for name in ("anchors, 5 trainings", "SGAN-20V, published network"):
        row = rows.row(by_predicate=pl.col("model") == name, named=True)
        errors = [float(row[place].split()[0]) for place in ("univ", "zara1", "zara2")]
        means.append(f"{np.mean(errors):.2f}")
    lead = f"it is {means[0]} against {means[1]} m"
    for page in (DOCS / "results.md", ROOT / "README.md"):
        assert lead in page.read_text(encoding="utf-8")


def test_pages_on_learning_a_place_have_what_the_study_prints():
    table, means = place.page(pl.read_csv(place.TABLE)).split("\n\n")
    page = beside_studies("place")
    assert table in page
    page = page.replace("−", "-")
    numbers = re.findall(r": ([+-][\d.]+ ± [\d.]+) % \(\d+\)", means)
    counts = re.findall(r"\((\d+)\)", means)
    assert len(numbers) == len(counts) == 8
    for row in range(0, 8, 2):
        cells = f"| {counts[row]} | {numbers[row]} | {numbers[row + 1]} |"
        assert cells in page
    entrance = (DOCS / "place.md").read_text(encoding="utf-8").replace("−", "-")
    row = counts.index("24")  # Those on which no choice was made.
    fall = numbers[row].removeprefix("-")
    assert f"energy score there by {fall} %.** That is the mean of 24 " in entrance
    assert f"In the second half of a recording it is {numbers[row + 1]} %" in entrance


def test_the_page_of_places_left_out_is_what_its_study_prints(capsys):
    run_module("studies.places")
    page = (ROOT / "studies" / "pages" / "left_out.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out == page


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_mistakes(mistake, tmp_path):
    verdict, message = tell(mistake, tmp_path)
    assert (verdict, bool(re.search(mistake.says, message))) == (
        mistake.outcome,
        True,
    ), message


def test_scores_by_different_numbers_of_draws_are_not_put_in_one_table():
    rows = pl.DataFrame({"model": ["anchors", "SGAN"], "draws": [100, 20]})
    with pytest.raises(InputError, match=r"draws: scores by \[20, 100\] draws"):
        distribution_table(rows)


def test_a_table_of_energy_scores_has_one_model_of_a_kind():
    """A network of simulations, whose score is three times as high, stood in SGAN's column."""
    row = {"draws": 100, "pred_len": 8, "dataset": "eth"}
    ends = {"coverage_50": 0.5, "coverage_90": 0.9, "draw_collisions": 0.001}
    row |= ends | {"truth_collision_rate": 0.002}
    rows = []
    for model, checkpoint, score, p in (
        ("anchors", "anchors_eth_8", 0.56, None),
        ("SGAN", "sgan_eth_8", 0.66, 0.01),
        ("SGAN", "sgan_simulations_8", 2.1, 0.01),
    ):
        interval = {"energy_score_low": score - 0.1, "energy_score_high": score + 0.1}
        named = {"model": model, "checkpoint": checkpoint, "energy_score": score}
        rows.append({**row, **named, **interval, "energy_score_p": p})
    line = distribution_table(pl.DataFrame(rows))[1]
    assert line[:3] == ["eth", "8 + 8", "0.560 ±0.100"]
    # A star would say "better", as in the tables of `evaluate`.
    assert line[6:] == ["0.660 ±0.100†", "-", "50 / 90", "0.1 / 0.2"]
    rows.append({**rows[1], "checkpoint": "sgan_eth_8_again"})
    with pytest.raises(InputError, match="eth: two models are SGAN"):
        distribution_table(pl.DataFrame(rows))


def test_the_page_of_the_distribution_has_its_table():
    assert results.energy_scores() in beside_studies("distribution")


def test_the_page_of_weighting_has_the_trainings_of_its_table():
    page = (DOCS / "weighting.md").read_text(encoding="utf-8").replace("−", "-")
    table = pl.read_csv(DOCS / "weighting_training.csv")
    for row in table.filter(pl.col("reference") == "NeuroSyM, ones").to_dicts():
        error = row["error_of_reference"]
        half = (row["high_95"] - row["low_95"]) / 2
        cells = [f"{error:.3f}", f"{100 * row['difference'] / error:+.1f} ± "]
        cells[1] += f"{100 * half / error:.1f}"
        line = [row["training"], str(row["pred_len"]), *cells]
        assert f"| {' | '.join(line)} |" in page


def beside_studies(name: str) -> str:
    """The page `name` beside the studies."""
    return (ROOT / "studies" / "pages" / f"{name}.md").read_text(encoding="utf-8")


def test_data_kept_back_and_test_data_are_not_trained_on(tmp_path):
    opentraj, out = tmp_path / "opentraj", tmp_path / "out"
    for folder in (STANFORD, HERMES):
        (opentraj / folder).mkdir(parents=True)
    for name in (*KEPT_BACK, *STANFORD_TESTED, "gates_0"):
        (opentraj / STANFORD / f"{name}.txt").write_text("0 1 0 0\n12 1 0.5 0\n")
    walk = [(1, frame, 100 + 10 * frame, 50, 0) for frame in range(64)]
    for name in (*LEARNED, *TESTED, "boa-300-050-070"):
        np.savetxt(opentraj / HERMES / f"{name}.txt", walk)
    write(opentraj, out)
    files = {}
    for folder in out.iterdir():
        files[folder.name] = {path.stem for path in folder.iterdir()}
    tests, kept = {*TESTED, *STANFORD_TESTED}, set(KEPT_BACK)
    learned = {"stanford": {"gates_0"}, "hermes": set(LEARNED)}
    assert files == learned | {"tests": tests, "kept_back": kept}
    # 16 frames of 10 cm a second are 0.64 m in 0.4 s.
    walked = read_any(out / "hermes" / f"{LEARNED[0]}.txt")[0].position
    np.testing.assert_allclose(np.diff(walked[:, 0]), 0.64, atol=1e-4)


def shown(code, names):
    """Kinds of what a cell shows: text, and a picture of each of pyplot's figures."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, names)
    kinds = ["text"] * bool(printed.getvalue()) + ["image"] * len(plt.get_fignums())
    plt.close("all")
    return kinds


def test_notebooks_begin_with_what_they_are_about_and_how_to_install():
    firsts = set()
    paths = list(FOLDER.glob("*.ipynb"))
    for path in paths:
        title, first, *_ = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert title["cell_type"] == "markdown"
        assert title["source"][0].startswith("# ")
        firsts.add("".join(first["source"]))
    assert len(paths) >= 10
    (code,) = firsts
    assert 'find_spec("neurosym_jax")' in code


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        exhaustive(path.stem) if path.stem in LONG else path.stem
        for path in sorted(FOLDER.glob("*.ipynb"))
    ],
)
def test_a_notebook_runs_and_shows_what_is_kept_in_it(
    name, request, tmp_path, monkeypatch
):
    """Run it in this process, where most of its programs are compiled already."""
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    collection = DOWNLOADED.get(name)
    if collection:
        data = request.getfixturevalue("shared") / "data" / collection.replace("-", "_")
        (tmp_path / collection).symlink_to(data)
        monkeypatch.setenv("NEUROSYM_DATA", str(tmp_path))
    monkeypatch.chdir(FOLDER)
    plt.switch_backend("Agg")
    cells = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    kinds, names = {"stream": "text", "display_data": "image"}, {"__name__": "__main__"}
    outputs_by_code = []
    for cell in cells:
        if cell["cell_type"] == "code":
            outputs = [kinds.get(output["output_type"]) for output in cell["outputs"]]
            outputs_by_code.append(("".join(cell["source"]), outputs))
    assert ["image"] in [outputs for _, outputs in outputs_by_code]
    for code, outputs in outputs_by_code:
        # A last line's value is shown by a notebook alone.
        assert shown(code, names) == list(filter(None, outputs))
