"""Which recipe is best in unseen places, judged for every scene by the other four.

python -m studies.left_out DATA OUT RECIPE [RECIPE ...] [--seeds N] [--steps N] \\
    [--pairs eth+hotel ...] [--more FOLDER] > docs/left_out.md

A RECIPE is `ours`, or a list of changes to it or to the network, such as
`scale=0.3,ema=0.9`; with `more=NAME+NAME` it learns from these folders of `--more` besides
(`studies.more_data` makes them). Of every pair of ETH/UCY's five scenes, models are trained on the
others, as `train.py --dataset` would, and tested on both. The error by which a recipe is judged for
a scene is the mean over its pairs, always tested on the other scene of the pair: nothing of the
scene itself is in it, neither as training nor as test. Runs are single-threaded, as many at once as
there are cores; a finished run is never trained again, so that seeds can be added later.
"""

import argparse
import dataclasses
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy.stats import t

from neurosym_jax.data.readers.eth_ucy import SCENES, split_files
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.runtime.environment import cpu_cores

LENGTHS = ("--obs-len", "8", "--pred-len", "12")
ERRORS = ("joint ADE", "joint FDE", "marginal ADE", "marginal FDE", "all ADE", "all FDE")
"""The last two are joint, with windows of one person, as means over windows (`joint-metrics`)."""
MORE = "more="
"""The change to a recipe that is neither of the training's options nor of the network's."""
ROOT = Path(__file__).resolve().parents[1]
PAGE = """# Which augmentation for unseen places?

Errors added to observed positions (`jitter`) help most; half of the scenes
turned (`rotate=0.5`) is best for four of five data sets ([why](recipe.md)).

ADE / FDE in metres of SGAN, 8 + 12, joint best of 20, {steps} steps of
training, {seeds}; `studies/left_out.py` says how. Bold is the best of a column.

Judged for each data set by the others that it was left out with:

{judged}

The same runs by the data set that they were tested on:

{tested}

Change of the mean over scenes against `{first}`, paired by seed, with
Student's 95 % interval over seeds where there are several:

{changes}"""


@dataclasses.dataclass(frozen=True)
class Study:
    """What is trained and tested."""

    data: Path
    """ETH/UCY as SGAN has it: `train`, `val` and `all`."""
    out: Path
    """Folder of the runs and the evaluations."""
    recipes: Sequence[str]
    steps: int
    seeds: Sequence[int]
    pairs: Sequence[tuple[str, ...]] = tuple(itertools.combinations(SCENES, 2))
    more: Path = Path()
    """Folder of the additional recordings that some recipes learn from."""

    def others(self) -> dict[str, list[str]]:
        """By scene, the others that it is left out with."""
        found = {
            scene: [other for other in SCENES if {scene, other} in map(set, self.pairs)]
            for scene in SCENES
        }
        return {scene: others for scene, others in found.items() if others}

    def folder(self, recipe: str, pair: tuple[str, ...], seed: int) -> Path:
        """Where the run of this recipe without this pair of scenes is."""
        return self.out / recipe / f"{'_'.join(sorted(pair))}_{seed}"

    def train(self, recipe: str, pair: tuple[str, ...], seed: int) -> None:
        """Train SGAN with this recipe on all scenes but the pair, unless that is done."""
        run = self.folder(recipe, pair, seed)
        if (run / "model").is_dir():
            return
        left_out = {name for scene in pair for name in SCENES[scene]}
        files = {
            split: [
                str(path)
                for path in split_files(self.data, None, split)
                if path.stem.removesuffix(f"_{split}") not in left_out
            ]
            for split in ("train", "val")
        }
        besides = recipe.partition(MORE)[2].partition(",")[0]
        more = [str(self.more / folder) for folder in besides.split("+") if folder]
        call(
            *("train.py", "--data", str(self.data), *LENGTHS, "--steps", str(self.steps)),
            *("--seed", str(seed), "--out", str(run), "--resume", *changes(recipe)),
            *("--train-on", *files["train"], "--validate-on", *files["val"]),
            *(("--train-also", *more) if more else ()),
        )

    def test(self, scene: str) -> np.ndarray:
        """Errors [recipes, `others`, seeds, `ERRORS`] on `scene`."""
        others = self.others()[scene]
        runs = [
            str(self.folder(recipe, (scene, other), seed) / "model")
            for recipe, other, seed in itertools.product(self.recipes, others, self.seeds)
        ]
        found: dict[str, list[float]] = {run: [] for run in runs}
        for protocol, kinds in (("sgan", ("joint", "marginal")), ("joint-metrics", ("joint",))):
            path = self.out / f"{scene}_{protocol}.json"
            call(
                *("evaluate.py", "--data", str(self.data), "--test-on", *SCENES[scene], *LENGTHS),
                *("--checkpoint", *runs, "--no-figures", "--protocol", protocol),
                *("--json", str(path)),
            )
            for row in json.loads(path.read_text())["rows"]:
                if row["checkpoint"] in found:
                    found[row["checkpoint"]] += [
                        row[f"{kind}_{error}"] for kind in kinds for error in ("ade", "fde")
                    ]
        errors = [found[run] for run in runs]
        shape = (len(self.recipes), len(others), len(self.seeds), len(ERRORS))
        return np.array(errors).reshape(shape)

    def page(self, errors: dict[str, np.ndarray]) -> str:
        """The page, of `test`'s errors on each scene."""
        seeds = "one seed" if len(self.seeds) == 1 else f"the mean of {len(self.seeds)} seeds"
        judged = {
            scene: np.stack(
                [errors[other][:, self.others()[other].index(scene)] for other in others]
            ).mean(axis=(0, 2))
            for scene, others in self.others().items()
        }
        return PAGE.format(
            steps=self.steps,
            seeds=seeds,
            judged=self.table(judged),
            tested=self.table({scene: each.mean(axis=(1, 2)) for scene, each in errors.items()}),
            first=self.recipes[0],
            changes=self.changes_table(errors),
        )

    def table(self, errors: dict[str, np.ndarray]) -> str:
        """A row each recipe, of joint errors [recipes, `ERRORS`] by scene."""
        columns = []
        for values in errors.values():
            texts = [[f"{error:.3f}" for error in row[:2]] for row in values]
            least = [min(part) for part in zip(*texts)]
            bold = [
                [f"**{text}**" if text == best else text for text, best in zip(row, least)]
                for row in texts
            ]
            columns.append([" / ".join(row) for row in bold])
        names = [f"`{recipe.replace(',', ' ')}`" for recipe in self.recipes]
        rows = [list(row) for row in zip(names, *columns)]
        return markdown_table(["changes to the recipe", *errors], rows)

    def changes_table(self, errors: dict[str, np.ndarray]) -> str:
        """A row each recipe after the first, in per cent of the first."""
        by_seed = np.mean([values.mean(axis=1) for values in errors.values()], axis=0)
        percent = 100 * (by_seed[1:] / by_seed[0] - 1)
        count = len(self.seeds)
        rows = []
        for recipe, values in zip(self.recipes[1:], percent):
            cells = [f"{mean:+.1f} %" for mean in values.mean(axis=0)]
            if count > 1:
                half = t.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
                cells = [f"{cell} ± {width:.1f}" for cell, width in zip(cells, half)]
            rows.append([f"`{recipe.replace(',', ' ')}`", *cells])
        return markdown_table(["changes to the recipe", *ERRORS], rows)


def changes(recipe: str) -> list[str]:
    """The options of `train.py` that make these changes."""
    if recipe == "ours":
        return []
    known = {field.name for field in dataclasses.fields(GeneratorConfig)}
    options: dict[str, list[str]] = {"--set": [], "--network": []}
    for change in recipe.split(","):
        if change.startswith(MORE):
            continue
        options["--network" if change.partition("=")[0] in known else "--set"].append(change)
    return [word for name, values in options.items() if values for word in (name, *values)]


def call(*command: str) -> None:
    """Run one of the project's commands with one thread, its words on our standard error."""
    environment = {**os.environ, "NPROC": "1"}
    subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, stdout=sys.stderr, check=True
    )


def main() -> None:
    """Train what is not trained yet, test all, print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("recipes", nargs="+")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--more", type=Path, default=Path())
    parser.add_argument("--pairs", nargs="+", default=["+".join(p) for p in Study.pairs])
    options = parser.parse_args()
    places = {name: getattr(options, name).resolve() for name in ("data", "out", "more")}
    seeds, pairs = range(options.seeds), [tuple(pair.split("+")) for pair in options.pairs]
    study = Study(**places, steps=options.steps, recipes=options.recipes, seeds=seeds, pairs=pairs)
    # Whole seeds first: an early look has all pairs.
    runs = itertools.product(study.seeds, study.pairs, study.recipes)
    with ThreadPoolExecutor(cpu_cores()) as pool:
        jobs = [pool.submit(study.train, recipe, pair, seed) for seed, pair, recipe in runs]
        for job in jobs:
            job.result()
    print(study.page({scene: study.test(scene) for scene in study.others()}))


if __name__ == "__main__":
    main()
