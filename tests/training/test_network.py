import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.models import AsDescribed, Social
from neurosym_jax.symbolic.state_weightings import Cnd, Learned
from neurosym_jax.symbolic.weightings import Ones
from neurosym_jax.training.network import model_name, named_network, named_weighting


def test_generators():
    assert named_network(pred_len=12).pred_len == 12
    social = named_network(pooling="social")
    assert social.pooling == Social()
    symbolic = named_network("neurosym", weighting="ones")
    assert (symbolic.pooling, symbolic.weighting) == (AsDescribed(), Ones())


def test_changes():
    changed = named_network("neurosym", changes=["noise_type=uniform", "encoder_h_dim=48"])
    assert (changed.noise_type, changed.encoder_h_dim) == ("uniform", 48)
    assert (changed.pooling, changed.weighting) == (AsDescribed(), Cnd())
    for change, reason in (
        ("noise_dim=99", "network: noise_dim must lie in"),
        ("noise=uniform", "--network noise=uniform: must be NAME=VALUE"),
        ("noise_type=fix", "network: noise_type"),
    ):
        with pytest.raises(InputError, match=reason):
            named_network(changes=[change])


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"weighting": "cnd"}, "--weighting cnd: sgan weights no pairs; neurosym does"),
        ({"pooling": "encounter"}, "--pooling encounter: sgan has none, pool_net, social"),
        ({"model": "neurosym", "pooling": "none"}, "--pooling none: neurosym has as_described"),
    ],
)
def test_what_a_model_cannot_have_is_refused(named, message):
    with pytest.raises(InputError, match=message):
        named_network(**named)


def test_names():
    assert model_name(named_network(pooling="none")) == "sgan_none"
    coarse = named_network("neurosym", weighting="quantised,quantisation_factor=0.05")
    assert model_name(coarse) == "neurosym_as_described_quantised"
    assert model_name(named_network("neurosym", pooling="neurosym_ros")) == "neurosym_ros_cnd"


def test_weightings(tmp_path, monkeypatch):
    assert named_weighting("cnd") == Cnd()
    coarse = named_weighting("learned,quantisation_factor=0.1,table=cnd_shipped")
    assert coarse == Learned(table="cnd_shipped", quantisation_factor=0.1)
    assert named_weighting(coarse.name) == coarse
    for text, reason in (
        ("cdn", "weighting cdn: unknown weighting 'cdn'"),
        ("cnd,tabel=cnd", "unknown field 'tabel'"),
        ("cnd_shipped,decimals=x", "decimals must be a whole number"),
        ("no_such_module:mine", "plugin no_such_module: cannot be imported"),
    ):
        with pytest.raises(InputError, match=reason):
            named_weighting(text)
    monkeypatch.syspath_prepend(tmp_path)
    # Else the runs of later tests would be told to load it, too.
    monkeypatch.setattr("neurosym_jax.plugins._loaded", {})
    (tmp_path / "weightings_of_mine.py").write_text(
        "from neurosym_jax.symbolic import register_weighting\n"
        "register_weighting('all_alike')(lambda positions, valid: 0 * positions[:, None, :, 0])\n"
    )
    assert named_weighting("weightings_of_mine:all_alike").name == "all_alike"
