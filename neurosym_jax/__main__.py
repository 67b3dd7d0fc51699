"""`python -m neurosym_jax VERB`: every command by a name, each imported when it is asked for."""

import importlib
import sys
from typing import NamedTuple

from neurosym_jax.command import run_command


class Verb(NamedTuple):
    """A command: a function of its module, and the dataclass of its options there."""

    text: str
    module: str
    action: str
    options: str


VERBS = {
    "train": Verb("train a model, as train.py does", "training.run", "train", "TrainOptions"),
    "sweep": Verb(
        "train and test many models, a process each", "training.sweep", "sweep", "SweepOptions"
    ),
    "download": Verb(
        "fetch ETH/UCY or SGAN's checkpoints; say how to get THÖR",
        "data.download",
        "download",
        "DownloadOptions",
    ),
    "report": Verb(
        "compare a sweep's models, with intervals", "training.report", "report", "ReportOptions"
    ),
    "symbols": Verb(
        "show a recording's QTC symbols and weights", "views.symbols", "symbols", "SymbolsOptions"
    ),
    "inspect": Verb(
        "say what a recording, or a folder of them, holds",
        "data.inspect",
        "inspect",
        "InspectOptions",
    ),
    "parity": Verb(
        "compare our numbers with torch's, output by output",
        "interop.parity",
        "parity",
        "ParityOptions",
    ),
    "experiment": Verb(
        "repeat the robot paper's experiment on simulated recordings",
        "online.experiment",
        "experiment",
        "ExperimentOptions",
    ),
    "ros1": Verb("forecast in a ROS 1 graph", "online.ros1", "ros1", "Ros1Options"),
    "replay": Verb(
        "forecast a recording as if it were live",
        "online.replay_verb",
        "replay",
        "ReplayOptions",
    ),
    "ros2": Verb("forecast in a ROS 2 graph", "online.ros2", "ros2", "Ros2Options"),
    "stitch": Verb(
        "join tracks that occlusions broke", "online.stitch_verb", "stitch", "StitchOptions"
    ),
}


def main(arguments: list[str]) -> None:
    """Run the verb that `arguments` name."""
    if not arguments or arguments[0] not in VERBS:
        width = max(map(len, VERBS))
        print("usage: python -m neurosym_jax VERB [--help]\n")
        print("\n".join(f"  {name:{width}}  {verb.text}" for name, verb in VERBS.items()))
        sys.exit(0 if arguments in ([], ["-h"], ["--help"]) else 2)
    name, *rest = arguments
    verb = VERBS[name]
    module = importlib.import_module(f"neurosym_jax.{verb.module}")
    options, action = getattr(module, verb.options), getattr(module, verb.action)
    run_command(options, action, rest, f"python -m neurosym_jax {name}")


if __name__ == "__main__":
    main(sys.argv[1:])
