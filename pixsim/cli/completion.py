"""`pixsim completion`: the shell completes commands and options."""

from __future__ import annotations

from typing import Literal

from pixsim.cli.base import Json, app, show


@app.command
def completion(shell: Literal["bash", "zsh", "fish"], *, json: Json = False) -> None:
    """Print a script that makes a shell complete commands and options.

    Example: pixsim completion bash > ~/.local/share/bash-completion/completions/pixsim

    Example: pixsim completion fish > ~/.config/fish/completions/pixsim.fish

    Parameters
    ----------
    shell
        bash, zsh (into a folder of $fpath, as _pixsim) or fish.
    """
    script = app.generate_completion(prog_name="pixsim", shell=shell)
    show({"shell": shell, "script": script}, json, script)
