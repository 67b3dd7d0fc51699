import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.training.recipe import RECIPES, make_recipe


@pytest.mark.parametrize(
    ("steps", "change", "reason"),
    [
        (None, "emma=0.9", "--set emma=0.9: must be NAME=VALUE"),
        (None, "ema", "--set ema: must be NAME=VALUE"),
        (None, "format=2", "must be NAME=VALUE"),
        (None, "ema=fast", "ema must be a finite number, not 'fast'"),
        (None, "best_k=2.5", r"best_k must be a whole number, not 2\.5"),
        (None, "criterion=best", "criterion must be one of squared_displacement, distance"),
        (None, 'discriminator={"kind": "big"}', "kind must be one of global, local, not 'big'"),
        (0, "ema=0.9", "recipe ours: steps must be at least 1, not 0"),
        (None, "steps=-25", "steps must be at least 1, not -25"),
    ],
)
def test_recipes_that_cannot_be(steps, change, reason):
    with pytest.raises(InputError, match=reason) as caught:
        make_recipe("ours", steps=steps, changes=[change])
    assert "\n" not in str(caught.value)


def test_recipes():
    assert make_recipe("ours") == RECIPES["ours"]
    changes = ("rotate=0.5", "max_agents=null", "label_real=[0.9, 1]", "schedule=cosine")
    changed = make_recipe("sgan", seed=3, steps=30, changes=changes)
    assert (changed.seed, changed.steps, changed.rotate, changed.max_agents) == (3, 30, 0.5, None)
    assert (changed.label_real, changed.schedule) == ((0.9, 1), "cosine")
    assert changed.g_learning_rate == RECIPES["sgan"].g_learning_rate
