"""`pixsim doctor`: what the machine has, whether renders work, and what mends what does not."""

from __future__ import annotations

import json as json_format
import shutil
import sys
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pixsim.cli.base import DEFAULT_OUT, FILE_WIDTH, Json, Out, app
from pixsim.errors import refuse

if TYPE_CHECKING:
    from pixsim.doctor import Finding

SICK = 1  # exit code
SUBJECT_WIDTH = 20


@app.command
def doctor(
    *,
    out: Out = None,
    limit_s: Annotated[float | None, Parameter(help="For each process that tries something [default: 20].")] = None,
    json: Json = False,
) -> None:
    """What this machine has for pixsim, whether renders work and are right, and the command that mends what does not.

    Example: pixsim doctor

    A line is marked ok, note (renders work all the same) or problem. The exit code is 0 without a problem, else 1.
    """
    from pixsim.doctor import LIMIT_S, PROBLEM, examine

    if limit_s is not None and not 0 < limit_s < float("inf"):
        raise refuse("--limit-s", f"{limit_s:g}", "a number above 0")
    findings = examine(Path(out or DEFAULT_OUT), LIMIT_S if limit_s is None else limit_s)
    sick = any(each.mark == PROBLEM for each in findings)
    if json:
        print(json_format.dumps({"ok": not sick, "findings": [asdict(each) for each in findings]}, indent=2, ensure_ascii=False))
    else:
        print(report(findings, shutil.get_terminal_size().columns if sys.stdout.isatty() else FILE_WIDTH))
    if sick:
        sys.exit(SICK)


def report(findings: list[Finding], width: int) -> str:
    """A line for each finding under its room, the mending command below it, and a summary."""
    from pixsim.doctor import NOTE, PROBLEM

    lines: list[str] = []
    room = None
    for each in findings:
        if each.room != room:
            room = each.room
            lines += [*([""] if lines else []), room]
        start = f"  {each.mark:<8} {each.subject:<{SUBJECT_WIDTH}} "
        wrapped = textwrap.wrap(each.found, max(width - len(start), SUBJECT_WIDTH), break_long_words=False, break_on_hyphens=False)
        lines += [start + ("\n" + " " * len(start)).join(wrapped)]
        if each.mend:  # never wrapped, so that it can be copied
            lines.append(" " * 11 + f"mend it: {each.mend}")
    problems, notes = (sum(each.mark == mark for each in findings) for mark in (PROBLEM, NOTE))
    verdict = "pixsim does not work here as it is" if problems else "renders work here"
    return "\n".join([*lines, "", f"{verdict}: {_count(problems, 'problem')}, {_count(notes, 'note')}"])


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
