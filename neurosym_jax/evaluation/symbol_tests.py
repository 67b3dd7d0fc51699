"""Scores of symbols and events on a test set of a source, told and as what goes into a JSON."""

from collections.abc import Mapping
from typing import Any

from neurosym_jax.data.sources import Source
from neurosym_jax.evaluation.plan import TestSet
from neurosym_jax.evaluation.symbol_cases import make_cases
from neurosym_jax.evaluation.symbol_report import format_symbol_scores, symbol_score_rows
from neurosym_jax.evaluation.symbols import evaluate_symbols
from neurosym_jax.forecasting.model import Model
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.futures import SymbolSettings

__all__ = ["score_symbols"]


def score_symbols(
    source: Source,
    test_set: TestSet,
    models: Mapping[str, Model],
    how: SymbolSettings,
    *,
    samples: int,
    seed: int,
) -> tuple[str, dict[str, Any]]:
    """How good the models' forecasts of symbols and events are, beside what needs no model.

    Args:
        source: of the test set, and of the training scenes that are left to its models.
        test_set: a dataset of the source, at the models' horizon.
        models: by name; the first one is compared with the Markov chain.
        how: of the symbols.
        samples: forecasts of each scene, k.
        seed: determines, with the scene and the sample, the noise.

    Returns:
        A table as text, and the same as JSON.

    Raises:
        InputError: where the source has no such dataset, or nothing to learn from.
    """
    name, steps = test_set.dataset, test_set.pred_len
    train, tune, test = (
        make_cases(source.recordings(name, split), test_set.obs_len, steps, how, tuple(EVENTS))
        for split in ("train", "val", "test")
    )
    scores = evaluate_symbols(train, tune, test, models, samples=samples, seed=seed)
    text = (
        f"{name}: {len(test.rows)} ordered pairs of {test.windows.scenes} windows\n"
        f"log score in nats, less is better\n\n{format_symbol_scores(scores, steps, how.period)}"
    )
    return text, {"dataset": name, "rows": symbol_score_rows(scores)}
