"""Names are registered once, plugins imported once, and a missing plugin is named."""

import dataclasses

import pytest

from neurosym_jax.__main__ import main
from neurosym_jax.errors import InputError
from neurosym_jax.models.disk import load_model, save_model
from neurosym_jax.plugins import Registry, load_plugin, loaded
from neurosym_jax.symbolic.weighting import register_weighting
from neurosym_jax.training.run import make_config
from tests.networks import random_model
from tests.registrations import restored_registrations

MISSING = "unknown weighting 'nearness'"


def test_without_its_plugin_a_model_says_what_it_needs(tmp_path, capsys, monkeypatch):
    """Every command says it; nothing that a model's folder names is imported."""
    model = tmp_path / "model"
    with restored_registrations():
        register_weighting("nearness", log_reach=0.0)(
            lambda positions, valid, log_reach: 0
        )
        network = make_config("neurosym", changes=["weighting=nearness"])
        own = dataclasses.replace(random_model(network, std=1.0), plugins=("near.py",))
        save_model(model, own)
        assert load_model(model).plugins == ("near.py",)
    (tmp_path / "near.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)

    def refusal(*command: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main(list(command))
        (line,) = capsys.readouterr().err.splitlines()
        assert caught.value.code == 2
        assert MISSING in line
        return line

    needs = "; it was trained with --plugin near.py"
    assert refusal("evaluate", "--model", "model").endswith(needs)
    assert refusal("symbols", "--model", "model").endswith(needs)
    words = ("--weighting", "nearness")
    for line in (
        refusal("train", "--family", "neurosym", *words),
        refusal("sweep", "--family", "neurosym", "--weighting", "nearness"),
        refusal("symbols", *words),
    ):
        assert "(--plugin FILE adds one)" in line


def test_names_are_kept_in_order_and_taken_once():
    registry: Registry[int] = Registry("number", {"two": 2})
    assert registry.register("one")(1) == 1
    registry.register("two", 2)
    assert dict(registry) == {"two": 2, "one": 1}
    with pytest.raises(InputError, match="another number 'two' already"):
        registry.register("two", 3)
    registry.register("two", 3, replace=True)
    assert list(registry.items()) == [("two", 3), ("one", 1)]
    with pytest.raises(InputError, match=r"unknown number 'six': there are two, one"):
        registry["six"]
    with pytest.raises(
        InputError, match=r"unknown number 'oen': did you mean 'one'\? there are"
    ):
        registry["oen"]
    with pytest.raises(InputError, match="cannot name a number"):
        registry.register("one, two", 3)


def test_a_plugin_is_imported_once(tmp_path, capsys):
    path = tmp_path / "mine.py"
    path.write_text("print('imported')")
    load_plugin(str(path))
    load_plugin(str(path))
    assert capsys.readouterr().out == "imported\n"
    (tmp_path / "other").mkdir()
    other = tmp_path / "other/mine.py"
    other.write_text("1 / 0")
    for plugin, reason in {
        str(other): "ZeroDivisionError: division by zero",
        str(tmp_path / "absent.py"): "no such file",
        "no_such_module": "ModuleNotFoundError",
    }.items():
        with pytest.raises(InputError, match=f"plugin {plugin}: .*{reason}"):
            load_plugin(plugin)
    assert loaded().count(str(path)) == 1
    assert str(other) not in loaded()
