import warnings

import numpy as np
import pytest

from neurosym_jax.commands.evaluate import default_models
from neurosym_jax.data.recordings import GENERAL, EthUcy, Files, Synthetic
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.compare import make_plan, make_test
from neurosym_jax.models.anchors.config import AnchorConfig
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.sgan.network import GeneratorConfig

MODELS = {
    "zara1_12": Model(GeneratorConfig(pred_len=12), {}, "zara1"),
    "eth_8": Model(GeneratorConfig(), {}, "eth"),
    "anywhere": Model(GeneratorConfig(), {}, None),
    "earlier": Model(GeneratorConfig(pooling="neurosym_ijcnn"), {}, "eth"),
    "simulated": Model(GeneratorConfig(), {}, "simulations"),
    "short": Model(AnchorConfig(short=True), {}, "eth", "anchors"),
}


def planned(*names, source=None, **options):
    """The paths of what is tested on each test set, without the baselines."""
    models = [(f"m/{name}", MODELS[name]) for name in names]
    plan = make_plan(source or EthUcy(), models, **options)
    for test, entries in plan.items():
        baselines = [model for path, model in entries if path is None]
        ships = (
            test.obs_len == 8
            and test.pred_len in (8, 12)
            and options.get("samples", 20) <= 20
        )
        kinds = [
            "constant_velocity",
            "constant_velocity_sampled",
            *["anchor_table"][:ships],
        ]
        assert [model.family for model in baselines] == kinds
        assert {model.forecaster.pred_len for model in baselines} == {test.pred_len}
        # The table of ETH/UCY has not learned from the data set that is tested.
        own = test.dataset if test.dataset in EthUcy().scenes else GENERAL
        assert [model.dataset for model in baselines[2:]] == [own][:ships]
    paths = {}
    for test, entries in plan.items():
        paths[test] = [path for path, _ in entries if path]
    return paths


def test_each_model_is_tested_on_the_set_that_it_left_out():
    names = ["eth", "hotel", "univ", "zara1", "zara2"]
    assert planned() == {Case(name, 8, 8): [] for name in names}
    assert planned(dataset="hotel", pred_len=12, obs_len=4) == {
        Case("hotel", 4, 12): []
    }
    sets = planned("zara1_12", "eth_8", "eth_8")
    assert sets == {
        Case("eth", 8, 8): ["m/eth_8"] * 2,
        Case("zara1", 8, 12): ["m/zara1_12"],
    }
    assert [test.dataset for test in sets] == ["eth", "zara1"]
    assert len(planned("anywhere")) == 5
    assert list(planned("anywhere", dataset="univ")) == [Case("univ", 8, 8)]
    assert len(planned("eth_8", source=Synthetic())) == 2
    assert [test.dataset for test in planned("simulated", source=Synthetic())] == (
        list(Synthetic().scenes)
    )
    assert len(planned(samples=21)) == 5
    assert planned("zara1_12", test_on=("a", "b")) == {
        Case("a+b", 8, 12): ["m/zara1_12"]
    }


def test_who_takes_short_histories_is_tested_by_them():
    assert planned("short") == {Case("eth", 8, 8): ["m/short"]}
    assert planned("short", obs_len=2) == {Case("eth", 2, 8): ["m/short"]}
    assert planned("short", "eth_8", only_matching=True, obs_len=2) == {
        Case("eth", 2, 8): ["m/short"]
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pred_len": 8}, "zara1_12: has pred_len 12, but pred_len=8 is asked for"),
        ({"obs_len": 4}, "zara1_12: has obs_len 8, but obs_len=4 is asked for"),
        (
            {"dataset": "eth"},
            "zara1_12: leaves zara1 out of its training, so dataset='eth' would",
        ),
        ({"dataset": "eth", "test_on": ("a",)}, "dataset and test_on"),
        (
            {"baselines": ("generator",)},
            "generator: cannot be a baseline, it has parameters",
        ),
        (
            {"baselines": ("anchors",)},
            "anchors: cannot be a baseline, it has parameters",
        ),
    ],
)
def test_contradictions(options, message):
    with pytest.raises(InputError, match=message):
        make_plan(EthUcy(), [("m/zara1_12", MODELS["zara1_12"])], **options)


def test_models_of_all_data_are_tested_elsewhere():
    general = ("m/all", Model(GeneratorConfig(), {}, GENERAL))
    with pytest.raises(InputError, match="m/all: learned from all of ETH/UCY"):
        make_plan(EthUcy(), [general])
    assert list(make_plan(EthUcy(), [general], test_on=["mine"])) == [
        Case("mine", 8, 8)
    ]
    assert list(make_plan(Files(("mine",)), [general])) == [Case("mine", 8, 8)]


@pytest.mark.parametrize(
    ("period", "warned"), [(0.395, 1), (0.397, 0), (0.403, 0), (0.405, 1)]
)
def test_steps_that_differ_by_one_per_cent_from_those_of_training_are_told(
    period, warned
):
    frame, person = np.divmod(np.arange(40), 2)
    tracks = make_tracks(
        "walk", period * frame, person, np.stack([0.5 * frame, person], axis=1)
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        test = make_test(Case("walk", 8, 8), [("m/eth_8", MODELS["eth_8"])], [tracks])
    assert test.windows.scenes == 5
    assert (
        sum("trained on steps of 0.4 s" in str(warning.message) for warning in caught)
        == warned
    )


def test_only_matching():
    def matching(**options):
        return list(
            planned(
                "zara1_12", "eth_8", "earlier", **options, only_matching=True
            ).values()
        )

    assert matching(pred_len=12) == [["m/zara1_12"]]
    assert matching(pred_len=20) == [[]] * 5
    assert matching() == [["m/eth_8"], ["m/zara1_12"]]


def test_default_models_fit_the_data():
    assert default_models(Synthetic(), None, None) == (
        ["sgan_simulations_8", "neurosym_simulations_8"]
    )
    assert default_models(EthUcy(), "zara1", None) == [
        "anchors_zara1_8",
        "neurosym_zara1_8",
    ]
    assert len(default_models(EthUcy(), None, 12)) == 7
    assert default_models(Files(("mine",)), None, None) == ["anchors_general_8"]
