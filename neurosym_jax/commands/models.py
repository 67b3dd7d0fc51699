"""Say which model to take, and list those at hand."""

from collections import Counter

from neurosym_jax.evaluation.tables import aligned_table
from neurosym_jax.models.disk import DOWNLOADED, load_model, models_at_hand

__all__ = ["run"]

FAMILIES = {
    # how its models' names begin: what it is, and what it is for
    "anchors": "attention over neighbours, 20 futures with probabilities: `recommended`",
    "anchor_table": "constant velocity and 20 fixed offsets: the baseline beside every model",
    "sgan": "SGAN, trained for ADE and FDE: comparison with published work",
    "neurosym": "SGAN with pairs weighted by QTC symbols: research on weighting",
    "sgan-20v": "SGAN as published, without pooling (neurosym download sgan-checkpoints)",
    "sgan-20vp": "SGAN as published, with pooling (the same download)",
}
OTHERS = "others"
HEAD = ("name", "forecaster", "steps", "period", "neighbours")
HEAD += ("test on", "learned from", "where")


def run(all: bool = False) -> None:
    """Say which model to take, and list the models that --model takes by name.

    `recommended` is the anchors model for the data set and horizon asked for.
    `sgan-20v` and `sgan-20vp` name all of SGAN's published models, without and with
    pooling.

    Args:
        all: List each model. The column neighbours has the share of people with
            a neighbour within 2 m whose forecast the neighbours change.
    """
    print(
        "recommended: take this one; it is the anchors model for your data set and horizon\n"
    )
    if all:
        print(_every_model())
    else:
        _print_families()


def _print_families() -> None:
    downloads = {folder.name: name for name, folder in DOWNLOADED.items()}
    longest_first = sorted(FAMILIES, key=len, reverse=True)
    counts: Counter[str] = Counter()
    for path, _ in models_at_hand():
        name = downloads.get(path.partition("/")[0], path)
        counts[next(filter(name.startswith, longest_first), OTHERS)] += 1
    for family, meaning in FAMILIES.items():
        print(f"  {family:14} {counts[family]:2} models  {meaning}")
    if counts[OTHERS]:
        print(f"  {OTHERS:14} {counts[OTHERS]:2} models")
    print("\nneurosym models --all lists each, with its data and licence")


def _every_model() -> str:
    """A table with a row for each model."""
    rows = []
    for name, path in models_at_hand():
        model = load_model(path)
        config = model.config
        licences = [f"{data} ({licence})" for data, licence in model.data.items()]
        share = "-"
        if model.neighbours is not None:
            share = f"{100 * model.neighbours:.0f} %"
        steps = f"{config.obs_len}+{config.pred_len}"
        period = f"{config.period:g} s"
        tested_on = model.dataset or "-"
        learned_from = ", ".join(licences) or "-"
        origin = (tested_on, learned_from, str(path.parent))
        rows.append((name, model.name, steps, period, share, *origin))
    return aligned_table([HEAD, *rows])
