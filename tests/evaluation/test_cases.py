from pathlib import Path
from types import SimpleNamespace

import pytest

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.data.sources import EthUcy, Synthetic
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import cases
from neurosym_jax.evaluation.cases import TestSet as Case_of
from neurosym_jax.evaluation.cases import make_cases
from neurosym_jax.forecasting.model import Model

MODELS = {
    "zara1_12": Model(GeneratorConfig(pred_len=12), {}, "zara1"),
    "eth_8": Model(GeneratorConfig(), {}, "eth"),
    "anywhere": Model(GeneratorConfig(), {}, None),
    "simulated": Model(GeneratorConfig(), {}, "cross-path"),
}


class Named(EthUcy):
    """ETH/UCY without files: a recording is its scene's name."""

    def recordings(self, scene, split="test"):
        return [SimpleNamespace(recording=scene)]

    def files(self, names):
        return [SimpleNamespace(recording=name) for name in names]


@pytest.fixture(autouse=True)
def _models(monkeypatch):
    monkeypatch.setattr(cases, "load_model", lambda path: MODELS[Path(path).name])
    monkeypatch.setattr(cases, "shipped_models", list)


def described(*checkpoints, source=None, **asked):
    return [
        (
            case.test_set,
            [tracks.recording for tracks in case.recordings],
            [path for path, _ in case.models],
        )
        for case in make_cases(lambda *_: source or Named(), checkpoints, **asked)
    ]


def test_without_checkpoints_the_baselines_everywhere():
    found = described()
    assert [test.scene for test, *_ in found] == ["eth", "hotel", "univ", "zara1", "zara2"]
    assert all((test.obs_len, test.pred_len) == (8, 8) for test, *_ in found)
    ((test, recordings, models),) = described(scene="hotel", pred_len=12, obs_len=4)
    assert (test, recordings, models) == (Case_of("hotel", 4, 12), ["hotel"], [])


def test_a_checkpoint_is_tested_on_its_own_scene():
    assert described("m/zara1_12", Path("m/eth_8"), "eth_8") == [
        (Case_of("eth", 8, 8), ["eth"], ["m/eth_8", "eth_8"]),
        (Case_of("zara1", 8, 12), ["zara1"], ["m/zara1_12"]),
    ]


def test_the_path_is_as_given():
    assert described("./m//eth_8")[0][2] == ["./m//eth_8"]


def test_a_checkpoint_without_a_scene_is_tested_on_all():
    assert len(described("anywhere")) == 5
    assert [test.scene for test, *_ in described("anywhere", scene="univ")] == ["univ"]
    assert len(described("eth_8", source=Synthetic())) == 2


def test_recordings_by_name():
    assert described("zara1_12", test_on=("a", "b")) == [
        (Case_of("a+b", 8, 12), ["a", "b"], ["zara1_12"])
    ]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"pred_len": 8}, "zara1_12: has pred_len 12, but --pred-len 8 is asked for"),
        ({"obs_len": 4}, "zara1_12: has obs_len 8, but --obs-len 4 is asked for"),
        ({"scene": "eth"}, "zara1_12: leaves zara1 out of its training, so --scene eth would"),
        ({"scene": "bogus"}, "unknown scene 'bogus': there are eth, hotel"),
        ({"scene": "eth", "test_on": ("a",)}, "--scene and --test-on"),
    ],
)
def test_contradictions(asked, message):
    with pytest.raises(InputError, match=message):
        described("zara1_12", **asked)


def test_what_ships_is_taken_as_far_as_it_fits(monkeypatch):
    monkeypatch.setattr(cases, "shipped_models", lambda: [Path("zara1_12"), Path("eth_8")])
    assert [models for *_, models in described(pred_len=12)] == [["zara1_12"]]
    assert [models for *_, models in described(pred_len=20)] == [[]] * 5
    assert [models for *_, models in described()] == [["eth_8"], ["zara1_12"]]
