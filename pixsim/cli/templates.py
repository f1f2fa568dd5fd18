"""`pixsim template` and `schema`: configuration files to start from, and what an editor needs to check them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pixsim.cli.base import Json, app, show
from pixsim.errors import refuse


@app.command
def template(
    kind: str,
    *,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"], help="TOML file [default: to standard output].")] = None,
    json: Json = False,
) -> None:
    """Write a commented configuration file with every field, its unit, default and allowed range.

    Example: pixsim template sensor -o my_sensor.toml

    Example: pixsim template study -o my_study.toml

    Parameters
    ----------
    kind
        sensor, for `pixsim run SCENE --config FILE` and `pixsim datasheet FILE`; or study, for `pixsim study FILE`.
    """
    from pixsim import templates
    from pixsim.files import write_new

    text = templates.template(kind)
    if output is None:
        show({"template": text}, json, text.rstrip())
        return
    if output.suffix != ".toml":
        raise refuse("--output", f"'{output}'", "a name that ends in .toml, as the commands know it by")
    write_new(output, text)
    use = f"pixsim run csf --config {output}" if kind == "sensor" else f"pixsim study {output}"
    show({"file": str(output), "use": use}, json, f"{output}: replace the numbers, then: {use}")


@app.command
def schema(kind: str = "sensor", *, json: Json = True) -> None:
    """Print the JSON schema of a configuration file, for editors that check and complete TOML.

    Example: pixsim schema study > study.schema.json

    Parameters
    ----------
    kind
        sensor or study.
    """
    from pixsim import templates

    show(templates.json_schema(kind), json, "")
