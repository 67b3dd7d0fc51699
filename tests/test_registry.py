import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_plugin, loaded
from neurosym_jax.registry import Registry


def test_names_are_kept_in_order_and_taken_once():
    registry: Registry[int] = Registry("number")
    registry.register("two", 2)
    registry.register("one", 1)
    registry.register("two", 2)
    assert dict(registry) == {"two": 2, "one": 1}
    with pytest.raises(InputError, match="another number 'two' already"):
        registry.register("two", 3)
    registry.register("two", 3, replace=True)
    assert list(registry.items()) == [("two", 3), ("one", 1)]
    with pytest.raises(InputError, match=r"unknown number 'six': there are two, one"):
        registry["six"]
    with pytest.raises(InputError, match="cannot name a number"):
        registry.register("one, two", 3)


def test_what_the_package_brings_is_there_before_anything_is_asked():
    registry: Registry[int] = Registry("number", lambda: registry.register("built_in", 0))
    with pytest.raises(InputError, match="already"):
        registry.register("built_in", 1)
    assert "built_in" in registry
    assert len(registry) == 1


def test_threads_wait_for_what_the_package_brings():
    def load():
        time.sleep(0.05)
        registry.register("built_in", 0)

    registry: Registry[int] = Registry("number", load)
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(registry.__getitem__, "built_in") for _ in range(4)]
        assert [each.result(timeout=10) for each in found] == [0] * 4


def test_who_loads_may_wait_for_who_registers():
    importing, registers = threading.Lock(), threading.Event()

    def load():
        registers.set()
        with importing:
            registry.register("one", 1)

    registry: Registry[int] = Registry("number", load)
    with ThreadPoolExecutor(1) as pool:
        with importing:  # As a module that is being imported.
            looks = pool.submit(registry.__getitem__, "one")
            assert registers.wait(timeout=10)
            registry.register("two", 2)
        assert looks.result(timeout=10) == 1
    assert dict(registry) == {"two": 2, "one": 1}


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
