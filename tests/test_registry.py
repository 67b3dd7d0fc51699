import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_plugin, loaded
from neurosym_jax.registry import Registry


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
    with pytest.raises(InputError, match=r"unknown number 'oen': did you mean 'one'\? there are"):
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
