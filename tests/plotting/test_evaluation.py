import numpy as np

from neurosym_jax.evaluation import cases
from neurosym_jax.plotting.evaluation import MOST, Shown, _drawn
from neurosym_jax.scene import make_scene


def shown(model, error):
    scene = make_scene(np.zeros((2, 8, 2)), np.zeros((2, 8, 2)))
    return Shown(
        cases.TestSet("a", 8, 8),
        model,
        scene,
        np.zeros((1, 2, 8, 2)),
        {},
        0.4,
        error,
    )


def test_each_of_a_few_models_has_a_name():
    few = [shown("cv", 1), shown("SGAN", 3), shown("SGAN", 2)]
    drawn = _drawn(few)
    assert list(drawn) == ["cv", "SGAN (1)", "SGAN (2)"]
    assert list(drawn.values()) == few


def test_of_many_models_the_best_of_each_name_is_drawn():
    many = [shown("cv", 9), *(shown("SGAN", abs(5 - number)) for number in range(MOST))]
    drawn = _drawn(many)
    assert list(drawn) == ["cv", f"SGAN, best of {MOST} models"]
    assert list(drawn.values()) == [many[0], many[6]]
