"""The help of a command: its common options with `--help`, all of them with `--help-all`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cyclopts import App
from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

# Most command lines need these alone, of whichever command has them.
COMMON = frozenset(
    {
        "--scene",
        "--study",
        "--match",
        "--config",
        "--define",
        "--quick",
        "--axis",
        "--repeats",
        "--raw",
        "--seed",
        "--jobs",
        "--dry-run",
        "--figures",
        "--out",
        "--json",
        "--camera.focal-length-mm",
        "--camera.f-number",
        "--lens.file",
        "--pixel.technology",
        "--pixel.pitch-um",
        "--pixel.bits",
        "--pixel.full-well-e",
        "--pixel.read-noise-e",
        "--exposure.integration-s",
        "--exposure.gain-db",
        "--display.dots",
        "--pitch.min-um",
        "--pitch.max-um",
        "--pitch.count",
    }
)
MIN_SHORTENED = 30  # options: a command that has more shows the common ones first


class _CommonOptions(DefaultFormatter):
    """Prints the common options of each panel of a command's help."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print the common options of a panel, and how many it has; nothing of a panel without
        any.
        """
        common = [
            entry
            for entry in panel.entries
            if entry.positional_label or COMMON.intersection(entry.names)
        ]
        if len(common) < len(panel.entries):
            panel = panel.copy(
                entries=common, title=f"{panel.title} ({len(common)} of {len(panel.entries)})"
            )
        super().__call__(console, options, panel)


def print_help(app: App, arguments: Sequence[str]) -> str:
    """Print the help that a command line with `--help` asks for.

    Returns the line that says how to see all options of a command that has many; empty for another
    one.
    """
    command = next((word for word in arguments if not word.startswith("-") and word in app), None)
    if command is None:
        option_count = 0
    else:
        option_count = sum(
            argument.show for argument in app[command].assemble_argument_collection()
        )
    app.help_formatter = _CommonOptions() if option_count > MIN_SHORTENED else None
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    finally:
        app.help_formatter = None
    if option_count > MIN_SHORTENED:
        return f"\n`pixsim {command} --help-all` shows all {option_count} options.\n"
    return ""
