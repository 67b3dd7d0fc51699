import numpy as np

from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.results import Result
from neurosym_jax.evaluation.test_sets import TestSet as Case
from neurosym_jax.plotting.evaluation import MAX_MODELS, _drawn
from neurosym_jax.scene import make_scene


def result(model, error, checkpoint=None):
    scene = make_scene(np.zeros((2, 8, 2)), np.zeros((2, 8, 2)))
    one = np.ones((1, 1))
    errors = ErrorsByScene(("joint_ade",), error * one, one, np.zeros((1, 2)), 16)
    row = {"model": model, "checkpoint": checkpoint}
    return Result(Case("a", 8, 8), row, errors, scene, np.zeros((1, 2, 8, 2)), {}, 0.4)


def test_each_of_a_few_models_has_a_name():
    few = [result("cv", 1), result("SGAN", 3), result("SGAN", 2)]
    drawn = _drawn(few)
    assert list(drawn) == ["cv", "SGAN (1)", "SGAN (2)"]
    assert list(drawn.values()) == few


def test_models_of_one_name_are_told_apart_by_their_checkpoints():
    several = [result("cv", 1), *(result("SGAN", 1, f"runs/{run}/model") for run in "ab")]
    assert list(_drawn(several)) == ["cv", "SGAN a", "SGAN b"]


def test_of_many_models_the_first_of_each_name_is_drawn():
    many = [result("cv", 9), *(result("SGAN", abs(5 - number)) for number in range(MAX_MODELS))]
    drawn = _drawn(many)
    assert list(drawn) == ["cv", f"SGAN, first of {MAX_MODELS} models"]
    assert list(drawn.values()) == [many[0], many[1]]
