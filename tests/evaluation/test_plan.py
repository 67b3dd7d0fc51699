import pytest

from neurosym_jax.data.sources import GENERAL, EthUcy, Files, Synthetic
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import make_plan, one_of_each
from neurosym_jax.evaluation.test_sets import TestSet as Case
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import shipped_models
from neurosym_jax.models.config import GeneratorConfig

MODELS = {
    "zara1_12": Model(GeneratorConfig(pred_len=12), {}, "zara1"),
    "eth_8": Model(GeneratorConfig(), {}, "eth"),
    "anywhere": Model(GeneratorConfig(), {}, None),
    "earlier": Model(GeneratorConfig(pooling="neurosym_ijcnn"), {}, "eth"),
}


def planned(*names, source=None, **asked):
    """The paths of what is tested on each test set, without the baselines."""
    models = [(f"m/{name}", MODELS[name]) for name in names]
    plan = make_plan(source or EthUcy(), models, **asked)
    assert all(
        [model.kind for path, model in entries if path is None]
        == ["constant_velocity", "constant_velocity_sampled"]
        for entries in plan.values()
    )
    return {test: [path for path, _ in entries if path] for test, entries in plan.items()}


def test_without_checkpoints_the_baselines_everywhere():
    names = ["eth", "hotel", "univ", "zara1", "zara2"]
    assert planned() == {Case(name, 8, 8): [] for name in names}
    assert planned(dataset="hotel", pred_len=12, obs_len=4) == {Case("hotel", 4, 12): []}


def test_a_checkpoint_is_tested_on_its_own_dataset():
    found = planned("zara1_12", "eth_8", "eth_8")
    assert found == {Case("eth", 8, 8): ["m/eth_8"] * 2, Case("zara1", 8, 12): ["m/zara1_12"]}
    assert [test.dataset for test in found] == ["eth", "zara1"]


def test_a_checkpoint_without_a_dataset_is_tested_on_all():
    assert len(planned("anywhere")) == 5
    assert list(planned("anywhere", dataset="univ")) == [Case("univ", 8, 8)]
    assert len(planned("eth_8", source=Synthetic())) == 2


def test_recordings_by_name():
    assert planned("zara1_12", test_on=("a", "b")) == {Case("a+b", 8, 12): ["m/zara1_12"]}


def test_baselines_have_the_lengths_of_their_test_set():
    plan = make_plan(EthUcy(), [("m", MODELS["zara1_12"])], baselines=["constant_velocity"])
    ((_, baseline), (_, model)) = plan[Case("zara1", 8, 12)]
    assert baseline.forecaster.pred_len == model.forecaster.pred_len == 12


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"pred_len": 8}, "zara1_12: has pred_len 12, but --pred-len 8 is asked for"),
        ({"obs_len": 4}, "zara1_12: has obs_len 8, but --obs-len 4 is asked for"),
        ({"dataset": "eth"}, "zara1_12: leaves zara1 out of its training, so --dataset eth would"),
        ({"dataset": "bogus"}, "unknown dataset 'bogus': there are eth, hotel"),
        ({"dataset": "eth", "test_on": ("a",)}, "--dataset and --test-on"),
        ({"baselines": ("nobody",)}, "unknown forecaster 'nobody'"),
        ({"baselines": ("generator",)}, "generator: cannot be a baseline, it has parameters"),
    ],
)
def test_contradictions(asked, message):
    with pytest.raises(InputError, match=message):
        make_plan(EthUcy(), [("m/zara1_12", MODELS["zara1_12"])], **asked)


def test_what_learned_from_all_is_tested_elsewhere():
    everybody = ("m/all", Model(GeneratorConfig(), {}, GENERAL))
    with pytest.raises(InputError, match="m/all: learned from all of ETH/UCY"):
        make_plan(EthUcy(), [everybody])
    assert list(make_plan(EthUcy(), [everybody], test_on=["mine"])) == [Case("mine", 8, 8)]
    assert list(make_plan(Files(("mine",)), [everybody])) == [Case("mine", 8, 8)]


def test_only_matching():
    def found(**asked):
        return list(planned("zara1_12", "eth_8", "earlier", **asked, only_matching=True).values())

    assert found(pred_len=12) == [["m/zara1_12"]]
    assert found(pred_len=20) == [[]] * 5
    assert found() == [["m/eth_8"], ["m/zara1_12"]]


def test_of_what_ships_one_of_each_kind_where_it_belongs():
    ships = [(path.name, load_model(path)) for path in shipped_models()]

    def chosen(source, **asked):
        return sorted(name for name, _ in one_of_each(source, ships, **asked))

    assert chosen(Synthetic()) == ["neurosym_simulations_8", "sgan_simulations_8"]
    assert chosen(Synthetic(), pred_len=12) == ["anchors_general_12", "neurosym_eth_12"]
    assert chosen(EthUcy(), dataset="zara1") == ["anchors_zara1_8", "neurosym_zara1_8"]
    found = chosen(EthUcy(), pred_len=12)
    anchors = [f"anchors_{scene}_12" for scene in sorted(EthUcy().scenes)]
    assert found == [*anchors, "neurosym_eth_12", "neurosym_zara1_12"]
    # Of people whom no model knows: what was trained for others, then what was on real people.
    assert chosen(Files(("mine",))) == ["anchors_general_8", "neurosym_eth_8"]


def test_a_model_for_all_simulations_is_tested_on_each():
    model = ("m", Model(GeneratorConfig(), {}, "simulations"))
    assert [test.dataset for test in make_plan(Synthetic(), [model])] == list(Synthetic().scenes)
