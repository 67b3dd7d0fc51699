"""Say which model to take, and list all that ship or were downloaded."""

from collections import Counter

from neurosym_jax.evaluation.tables import aligned_table
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import DOWNLOADED, models_at_hand

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


def run(all: bool = False) -> None:
    """Say which model to take, and list the models that --checkpoint and --model take by name.

    `recommended` is the anchors model for the data set and horizon asked for.
    `sgan-20v` and `sgan-20vp` name all of SGAN's published models, without and with
    pooling.

    Args:
        all: List each model. The column neighbours has the share of people with
            somebody within 2 m whose forecast they change.
    """
    print(
        "recommended: take this one; it is the anchors model for your data set and horizon\n"
    )
    if not all:
        downloads = {folder.name: name for name, folder in DOWNLOADED.items()}
        names = [
            downloads.get(name.partition("/")[0], name) for name, _ in models_at_hand()
        ]
        longest_first = sorted(FAMILIES, key=len, reverse=True)
        counts = Counter(
            next(filter(name.startswith, longest_first), OTHERS) for name in names
        )
        for family, meaning in FAMILIES.items():
            print(f"  {family:14} {counts[family]:2} models  {meaning}")
        if counts[OTHERS]:
            print(f"  {OTHERS:14} {counts[OTHERS]:2} models")
        print("\nneurosym models --all lists each, with its data and licence")
        return
    head = (
        "name",
        "forecaster",
        "steps",
        "period",
        "neighbours",
        "test on",
        "learned from",
        "where",
    )
    table: list[tuple[str, ...]] = [head]
    for name, path in models_at_hand():
        model = load_model(path)
        config = model.config
        steps, period = f"{config.obs_len}+{config.pred_len}", f"{config.period:g} s"
        share = "-" if model.neighbours is None else f"{100 * model.neighbours:.0f} %"
        data = (
            ", ".join(f"{name} ({licence})" for name, licence in model.data.items())
            or "-"
        )
        table.append(
            (
                name,
                model.name,
                steps,
                period,
                share,
                model.dataset or "-",
                data,
                str(path.parent),
            )
        )
    print(aligned_table(table))
