"""Every field of every settings record at, just inside and just outside its ends, and with values
of a wrong kind; generated from the records.

A table of settings has up to ten wrong fields and all others at an end. The message names the wrong
ones, no other, each with its value and what is allowed. It is the same for a constructor in Python,
a TOML file and a command line. Nothing is written.
"""

import math
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

import pytest
import tomli_w
from helpers.commands import command
from helpers.record_fields import (
    VALID,
    Table,
    ends,
    fields,
    inside,
    kind_of,
    records,
    required,
    valid,
)

import pixsim
from pixsim.base.bounds import SMALLEST
from pixsim.base.problems import MAX_PROBLEMS
from pixsim.base.records import Record, checked
from pixsim.cli.mistakes import names_of
from pixsim.optics.prescription import _PrescriptionFile
from pixsim.sensor.reading import Readout
from pixsim.studies.files import load_study
from pixsim.studies.settings import PitchRange, Study
from pixsim.viewer.setting import Run, RunScene
from pixsim.viewer.settings_file import settings_layer

# Checked where the field is used, or by a rule of its own: see tests/optics/test_prescription.py.
WITHOUT_BOUNDS = {"radius_mm", "object_distance_mm"}
RECORDS = records()

NO_NUMBER = (True, "a number or a name")


def outside(kind: Table) -> list[tuple[object, str]]:
    """Values that a kind refuses, each with what the message says is allowed."""
    match kind["type"]:
        case "float" | "int" as number:
            low, high = ends(kind)
            is_int = number == "int"
            digits = "d" if is_int else "g"
            word = "a valid integer" if is_int else "a valid number"
            below, above = low - 1, high + 1
            if not is_int:
                below, above = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
            at_most = f"less than or equal to {high:{digits}}"
            if "lt" in kind:
                at_most = f"less than {kind['lt']:{digits}}"
            return [
                (below, f"greater than or equal to {low:{digits}}"),
                (above, at_most),
                *([(1e-40, f"0, or at least {SMALLEST:g}")] if not is_int and low <= 0 else []),
                *([(low + 0.5, word)] if is_int else []),
                *((value, "a finite number") for value in (math.nan, math.inf, -math.inf)),
                NO_NUMBER,
                *((value, word) for value in ("x", [], {})),
            ]
        case "literal":
            choices = repr(kind["expected"][0])
            return [("no_such", choices), (3, choices), ([], choices), NO_NUMBER]
        case "bool":
            return [("perhaps", "a valid boolean"), (3, "a valid boolean"), ([], "a valid boolean")]
        case "str":
            pattern = [("no such!", "match pattern")] if "pattern" in kind else []
            return [*pattern, (3, "a valid string"), ([], "a valid string"), NO_NUMBER]
        case "model":
            return [(value, "a table of ") for value in (3, "x", [3])]
        case "dict":
            return [(value, "") for value in (3, "x", [3])]
        case "tuple" if kind_of(kind["items_schema"][0])["type"] in ("float", "int"):
            part = kind_of(kind["items_schema"][0])
            others = [] if "variadic_item_index" in kind else inside(part)[:1]
            return [NO_NUMBER, *(([value, *others], allowed) for value, allowed in outside(part))]
    return [NO_NUMBER, (math.nan, "")] if kind["type"] == "union" else [NO_NUMBER]


Faults = dict[str, tuple[object, str]]


def tables(
    record: type[Record], is_option: Callable[[str, object], bool]
) -> Iterator[tuple[Table, Faults]]:
    """Yield tables of a record with up to ten faults, the other fields at their ends."""
    kinds = {name: kind for name, kind in fields(record).items() if is_option(name, None)}
    values = {
        name: [fault for fault in outside(kind) if is_option(name, fault[0])]
        for name, kind in kinds.items()
        if name not in WITHOUT_BOUNDS
    }
    for number in range(max(map(len, values.values()), default=0)):
        faults = [(name, row[number]) for name, row in values.items() if number < len(row)]
        for start in range(0, len(faults), MAX_PROBLEMS):
            wrong = dict(faults[start : start + MAX_PROBLEMS])
            good = {name: valid(name, kind, number) for name, kind in kinds.items()}
            table = good | {name: value for name, (value, _) in wrong.items()}
            yield {name: value for name, value in table.items() if value is not None}, wrong


def missed(message: str, where: str, faults: Faults) -> list[str]:
    """What a message should say of some faults, and does not."""
    lines = message.removeprefix("pixsim: ").splitlines()
    misses = []
    for name, (value, allowed) in faults.items():
        part = value[0] if isinstance(value, list) and value else value
        line = next(
            (text for text in lines if re.match(rf"{re.escape(where + name)}(\.0)?: ", text)), None
        )
        texts = [repr(part), repr(str(part)), repr(value), "a text of ", "neither "]
        if line is None:
            misses.append(f"{name} = {value!r}: expected a line on {where}{name}, got none")
            continue
        lines.remove(line)
        if not any(f"got {text}" in line for text in texts):
            misses.append(f"{name} = {value!r}: expected 'got {part!r}', got '{line}'")
        if allowed not in line.partition("; ")[2]:
            misses.append(f"{name} = {value!r}: expected '{allowed}', got '{line}'")
    return misses + [f"of no field that is wrong: {line}" for line in lines]


def refusal(call: Callable[[], object]) -> str:
    """The message of a call; empty if it raises none."""
    try:
        call()
    except pixsim.PixsimError as error:
        return str(error)
    return ""


# --- Python, files and command lines
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_python_refuses_what_a_field_does_not_allow(record: type[Record]) -> None:
    misses = []
    for table, faults in tables(record, lambda name, value: True):
        misses += missed(refusal(partial(record, **table)), "", faults)
    unknown = refusal(lambda: record(**required(record), no_such_name=1))
    if not unknown.startswith("no_such_name: unknown name; allowed: "):
        misses.append(f"no_such_name = 1: got '{unknown}'")
    assert not misses, "\n".join(misses)


def tables_inside(
    record: type[Record], path: tuple[object, ...] = ()
) -> Iterator[tuple[type[Record], object]]:
    """Yield a record and the records in it, with their paths; 0 stands for the first of a list."""
    yield record, path
    for name, kind in fields(record).items():
        part = kind_of(kind["items_schema"][0]) if kind["type"] == "tuple" else {}
        if kind["type"] == "dict":
            part = kind_of(kind["values_schema"])
            if part["type"] == "model":
                yield from tables_inside(part["cls"], (*path, name, "x"))
        elif kind["type"] == "model":
            yield from tables_inside(kind["cls"], (*path, name))
        elif part.get("type") == "model":
            yield from tables_inside(part["cls"], (*path, name, 0))


def nested(path: tuple[object, ...], table: Table):
    """A table at its path in a file."""
    for part in reversed(path):
        table = [table] if part == 0 else {part: table}
    return table


@dataclass(frozen=True)
class Place:
    """Where a file has the table of a record.

    root : the record of the whole file
    path : of the table in it
    read : reads the file
    """

    root: type[Record]
    path: tuple[object, ...]
    read: Callable[[str], object]

    @property
    def words(self) -> str:
        """The path as messages have it."""
        return "".join(f"{part}." for part in self.path)

    def text(self, table: Table) -> str:
        """The file, with all else that it needs."""
        if self.root is not pixsim.Technology:
            return tomli_w.dumps(required(self.root) | nested(self.path, table))
        entries = required(pixsim.Technology) | VALID["junction", "model"] | table
        name = entries.pop("name")
        numbers = {
            key: {"value": value, "confidence": "A", "source": "x"}
            for key, value in entries.items()
        }
        return tomli_w.dumps({"name": name, **numbers})


PLACES = {
    record: Place(root, path, read)
    for root, read in (
        (_PrescriptionFile, pixsim.load_lens),
        (pixsim.Technology, pixsim.load_technology),
        (Study, load_study),
        (Run, lambda path: checked(Run, [settings_layer(path)])),
    )
    for record, path in tables_inside(root)
}


def message_of_file(place: Place, table: Table, path: Path) -> str:
    """The message of a file, with its name as "FILE".

    Files of lenses and technologies may be another than the user believes: their names are counted,
    and surfaces are numbered from 1.
    """
    path.write_text(place.text(table), encoding="utf-8")
    message = refusal(lambda: place.read(str(path))).replace(str(path), "FILE")
    message = message.replace("(a name of 1 character)", "x")
    message = message.replace("(a name of 12 characters)", "no_such_name")
    return re.sub(r"'FILE', surface 1( \(line \d+\))?: ", "FILE: surface.0.", message)


@pytest.mark.parametrize("record", PLACES, ids=lambda record: record.__name__)
def test_file_refuses_what_a_field_does_not_allow(record: type[Record], tmp_path: Path) -> None:
    place = PLACES[record]
    where = f"FILE: {place.words}"

    def is_entry(name: str, value) -> bool:
        """Whether it is an entry of a technology's file."""
        kind = fields(record)[name]["type"]
        return place.root is not pixsim.Technology or kind not in ("dict", "model")

    misses = []
    for number, (table, faults) in enumerate(tables(record, is_entry)):
        message = message_of_file(place, table, tmp_path / f"{number}.toml")
        misses += missed(message, where, faults)
    others = {} if place.root is pixsim.Technology else required(record)
    message = message_of_file(place, others | {"no_such_name": 1}, tmp_path / "x.toml")
    # Another name in [scene] is a parameter of the scene.
    if record is not RunScene and "no_such_name: unknown name; allowed: " not in message:
        misses.append(f"no_such_name = 1: got '{message}'")
    assert not misses, "\n".join(misses)


LINES = {record: "run csf" for record, place in PLACES.items() if place.root is Run} | {
    PitchRange: "study pixel-size"
}
OTHER_OPTIONS = {"--window-mm": "--window", "--lens.file": "--lens", "--noise-budget": "a flag"}


def is_refused_text(kind: str, value) -> bool:
    """Whether the text of a value is refused as the value is. Infinity is left out, as one of many
    large numbers.
    """
    if isinstance(value, list) and value:
        return type(value[0]) in (int, float) and math.isfinite(value[0])
    if isinstance(value, float):
        return math.isfinite(value) or (kind == "float" and math.isnan(value))
    return isinstance(value, str) or (type(value) is int and kind != "str")


@pytest.mark.parametrize("record", LINES, ids=lambda record: record.__name__)
def test_command_line_refuses_what_a_field_does_not_allow(record: type[Record], here: Path) -> None:
    """The value of an option is a text. Nothing is written."""
    line, where = LINES[record], PLACES[record].words
    _, options = names_of(line.split()[0])
    option_names = {name: f"--{where}{name}".replace("_", "-") for name in fields(record)}
    option_names = {
        name: OTHER_OPTIONS.get(option, option) for name, option in option_names.items()
    }

    record_lists = {path[0] for _, path in tables_inside(record) if path and path[-1] == 0}

    def is_option(name: str, value) -> bool:
        kind = fields(record)[name]["type"]
        if option_names[name] not in options or kind == "model" or name in record_lists:
            return False
        return value is None or is_refused_text(kind, value)

    misses = []
    for table, faults in tables(record, is_option):
        words = []
        for name, value in table.items():
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            words += [option_names[name], text]
        code, out, err = command(line, *words)
        misses += missed(err, where, faults)
        misses += [f"exit code {code}, with {out!r}: {err}"] if (code, out) != (2, "") else []
    _, _, err = command(line, f"--{where}no-such-name", 1)
    if f"Unknown option: --{where}no-such-name" not in err:
        misses.append(f"no-such-name = 1: got '{err}'")
    assert not misses, "\n".join(misses)
    assert list(here.iterdir()) == []


# --- At the ends
# --------------------------------------------------------------------------------------------------

SHEET = {
    "pitch_um": 3.45, "full_well_e": 1e4, "read_noise_e": 2.0, "dark_current_e_per_s": 1.0, "quantum_efficiency": 0.6,
}  # fmt: skip
PROCESS = pixsim.load_technology("0.35um").model_dump()


def derived_of_pixel(settings: Table) -> list[float]:
    readout = Readout.of(pixsim.derive(pixsim.Pixel(**settings)))
    names = "full_well_e", "dark_current_e_per_s", "noise_floor_e", "dn_per_e", "adc_range_e"
    return [getattr(readout, name) for name in names]


def derived_of_camera(settings: Table) -> list[float]:
    camera = pixsim.Camera(**settings)
    image = [camera.magnification, camera.image_distance_mm, camera.effective_f_number]
    return [*image, camera.chart_half_width_m, camera.fov_deg, camera.aperture_radius_m]


def derived_of_technology(settings: Table) -> list[float]:
    with patch("pixsim.sensor.pixel.load_technology", lambda _: pixsim.Technology(**settings)):
        return derived_of_pixel({"pitch_um": 6.5, "technology": "0.35um"})


@pytest.mark.parametrize(
    ("record", "settings", "derived"),
    [
        (pixsim.Pixel, SHEET, derived_of_pixel),
        (pixsim.Pixel, {"pitch_um": 6.5}, derived_of_pixel),
        (pixsim.Camera, {}, derived_of_camera),
        (pixsim.Technology, PROCESS | {"ranges": {}, "distributions": {}}, derived_of_technology),
    ],
    ids=["data sheet", "pixel", "camera", "technology"],
)
def test_numbers_at_an_end_are_refused_or_have_finite_consequences(
    record: type[Record], settings: Table, derived: Callable[[Table], list[float]]
) -> None:
    misses = []
    for name, kind in fields(record).items():
        for value in inside(kind)[:2] if kind["type"] in ("float", "int") else ():
            try:
                with warnings.catch_warnings(action="error", category=RuntimeWarning):
                    numbers = derived(settings | {name: value})
            except pixsim.PixsimError:
                continue
            if not all(map(math.isfinite, numbers)):
                misses.append(f"{name} = {value}: expected finite numbers, got {numbers}")
    assert not misses, "\n".join(misses)
