"""`python -m neurosym_jax VERB`: everything but evaluation."""

import sys

from neurosym_jax.command import run_command

VERBS = {
    "train": ("train a model, as train.py does", "training.run", "train"),
    "sweep": ("train and test many models, a process each", "training.sweep", "sweep"),
    "parity": ("compare our numbers with torch's, output by output", "interop.parity", "parity"),
}
"""verb: (what it does, module, function); its options are the module's `VerbOptions`."""


def main(arguments: list[str]) -> None:
    """Run the verb that `arguments` name."""
    if not arguments or arguments[0] not in VERBS:
        width = max(map(len, VERBS))
        print("usage: python -m neurosym_jax VERB [--help]\n")
        print("\n".join(f"  {verb:{width}}  {text}" for verb, (text, *_) in VERBS.items()))
        sys.exit(0 if arguments in ([], ["-h"], ["--help"]) else 2)
    verb, *rest = arguments
    _, module_name, function = VERBS[verb]
    module = __import__(f"neurosym_jax.{module_name}", fromlist=[function])
    options = getattr(module, f"{function.capitalize()}Options")
    run_command(options, getattr(module, function), rest, f"python -m neurosym_jax {verb}")


if __name__ == "__main__":
    main(sys.argv[1:])
