"""List the models that ship or were downloaded."""

from neurosym_jax.evaluation.markdown import aligned_table
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import models_at_hand

__all__ = ["run"]


def run() -> None:
    """List the models that --checkpoint and --model take by name.

    `sgan-20v` and `sgan-20vp` name all of SGAN's models without and with pooling. The column
    neighbours has the share of people with somebody within 2 m whose forecast they change.
    `recommended` is the anchors model for the data set and horizon that are asked for.
    """
    head = "name", "forecaster", "steps", "period", "neighbours", "test on", "learned from", "where"
    table: list[tuple[str, ...]] = [head]
    for name, path in models_at_hand():
        model = load_model(path)
        config = model.config
        steps, period = f"{config.obs_len}+{config.pred_len}", f"{config.period:g} s"
        share = "-" if model.neighbours is None else f"{100 * model.neighbours:.0f} %"
        data = ", ".join(f"{name} ({licence})" for name, licence in model.data.items()) or "-"
        table.append(
            (name, model.name, steps, period, share, model.dataset or "-", data, str(path.parent))
        )
    print(aligned_table(table))
