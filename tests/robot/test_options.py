"""Every option of the robot's commands changes what is done, or is refused."""

from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from neurosym_jax.__main__ import commands
from tests.commands.walk import READ, assert_it_matters, options_of, write_data

ROBOT = [
    name for name, module in commands().items() if module.startswith("neurosym_robot.")
]
C = "neurosym_robot.commands"
NODE = "--model sgan_zara1_8"
BASE = {
    "replay": f"{{d}}/a/walk.txt {NODE}",
    "ros1": NODE,
    "ros2": NODE,
    "stitch": "{d}/a/walk.txt --out o --period 0.4",
}
BAG = f"{{d}}/a/run.bag {NODE}"
LINKS = {
    f"--links.{name}": f"--links.{name} 0.7"
    for name in ("max-gap", "reach", "drift", "acceleration")
}
PAGE = {"--port": "--port 9", "--host": "--host there", "--map": "--map map.yaml"}


def with_more(base, options, cases):
    """Cases in which an option needs another one."""
    return {
        name: (f"{base} {options}", f"{base} {options} {case}")
        for name, case in cases.items()
    }


def live(base):
    return {
        "--model": "--model anchors_eth_12",
        "--period": "--period 0.5",
        "--max-people": "--max-people 3",
        "--samples": "--samples 3",
        "--seed": "--seed 3",
        "--hold": "--hold 0.5",
        "--min-seen": "--min-seen 1.5",
        "--stitch": "--stitch",
        "--place": "--place hall.npz",
        **with_more(base, "--place hall.npz", {"--half-life": "--half-life 600"}),
        **with_more(base, "--stitch", LINKS),
        **with_more(
            base,
            "",
            {
                "--fixed-frame": "--fixed-frame map",
                "--robot-frame": "--robot-frame base",
            },
        ),
        **with_more(base, "--fixed-frame map", {"--reach": "--reach 3"}),
        **with_more(
            base, "", {"--people": "--people tracks", "--only": "--only a.b=person"}
        ),
        **with_more(
            base, "--people tracks", {"--position": "--position at", "--id": "--id key"}
        ),
        "--dashboard": "--dashboard",
        **with_more(base, "--dashboard", PAGE),
        "--foxglove": "--foxglove 9",
        **with_more(base, "--dashboard", {"--at-least": "--at-least 0.7"}),
    }


def node(base):
    return live(base) | {
        "--at-least": "--at-least 0.7",
        "--name": "--name other",
        "--status": "--status 3",
        "--stale-after": "--stale-after 3",
        "--topic": "--topic /there",
        "--max-gap": "--max-gap 3",
    }


def reading(command):
    base, cases = BASE[command], {}
    for option, (file, text, *error) in READ.items():
        arguments = base.replace("walk.txt", file)
        cases[option] = (arguments, f"{arguments} {text}", *error)
    if command == "replay":
        return cases | {"--max-gap": "--max-gap 9"}
    return cases | {
        "--max-gap": (base, f"{base} --max-gap 9", "--max-gap: has no effect")
    }


CASES = {
    "replay": live(BAG)
    | {
        "RECORDING": (BASE["replay"], f"{{d}}/b/walk.txt {NODE}"),
        "--rate": "--rate 3",
        "--out": "--out here.bag",
        "--html": "--html here.html",
    }
    | reading("replay"),
    "ros1": node(NODE)
    | {"--master": "--master http://there:1", "--remap": "--remap a:=b"},
    "ros2": node(NODE)
    | {"--message": "--message Humans", "--ros-args": "--ros-args=-r"}
    | {"--autostart": "--no-autostart"},
    "stitch": {
        "TRACKS": (BASE["stitch"], "{d}/b/walk.txt --out o --period 0.4"),
        "--out": "--out here.txt",
        "--period": "--period 0.5",
        "--fill": "--fill 3",
    }
    | LINKS
    | reading("stitch"),
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = write_data(tmp_path_factory.mktemp("data"))
    (folder / "a" / "run.bag").touch()
    (folder / "a.h").write_text("0.5 0 0\n0 0.5 0\n0 0 1\n")
    return folder


@pytest.fixture(scope="module")
def inner():
    """By command: what is recorded and not run, and what it returns."""
    made = mock.MagicMock()
    made.return_value.status.table.return_value = (
        made.return_value.table.return_value
    ) = ""
    made.return_value.values.return_value = [made]
    made.return_value.frame = ""  # of a place
    names = ("load_models", "Predictor", "PeopleSource", "OnlineStitcher", "open_place")
    views = ("Dashboard", "FoxgloveView", "Moments", "Newest", "PlaceFile")
    shared: dict[str, Any] = {
        f"{C}._live_options.{name}": made for name in (*names, *views)
    }
    shared[f"{C}._live_options.signal.signal"] = None
    replay_names = (
        "Analytics",
        "Status",
        "replay",
        "ForecastBag",
        "ReplayFile",
        "Newest",
    )
    replay_names += ("wait_for_signal",)
    ros2_names = ("import_rclpy", "message_type", "ForecastNode")
    mended = SimpleNamespace(
        tracks=SimpleNamespace(id=np.ones(1)), before=1, joined=0, ghosts=0
    )
    return {
        "replay": shared
        | {f"{C}.replay.{name}": made for name in replay_names}
        | {"neurosym_robot.ros.bags.read_people": ()},
        "ros1": shared | {f"{C}.ros1.ForecastNode": made},
        "ros2": shared | {f"{C}.ros2.{name}": made for name in ros2_names},
        "stitch": {f"{C}.stitch.stitch": mended, f"{C}.stitch.write_text": None},
    }


@pytest.mark.parametrize(
    ("command", "option"),
    [(name, option) for name in ROBOT for option in options_of(name)],
)
def test_it_changes_what_is_done(command, option, data, inner, tmp_path, capsys):
    case = CASES[command][option]
    assert_it_matters(
        command, BASE[command], case, inner[command], data, tmp_path, capsys
    )
