"""Print a script that completes commands and options in a shell.

Bash: `neurosym completion bash > ~/.local/share/bash-completion/completions/neurosym`.
Zsh: `neurosym completion zsh > _neurosym`, in a folder of `$fpath`.
Fish: `neurosym completion fish > ~/.config/fish/completions/neurosym.fish`.
"""

import dataclasses
import importlib
from typing import Annotated, Literal

import tyro

from neurosym_jax.__main__ import commands
from neurosym_jax.commands._running import with_plugins

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Print a script that completes commands and options in a shell."""

    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional]
    """Shell; a new one reads the script from its folder of completions."""


def run(options: Options) -> None:
    """Print the script."""
    modules = {name: importlib.import_module(module) for name, module in commands().items()}
    tyro.extras.subcommand_cli_from_dict(
        {name: with_plugins(module.Options) for name, module in modules.items()},
        prog="neurosym",
        args=["--tyro-print-completion", options.shell],
    )
