"""Compare two results that exist: frames of the same light and random streams are paired from the tables in their folders."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pixsim.base.arguments import checks_arguments
from pixsim.base.errors import invalid
from pixsim.base.files import version_of_files
from pixsim.base.schema import check_not_newer
from pixsim.base.version import VERSION
from pixsim.show.document import Answer, Block, DocumentTable, Listed, Strong, plain_text
from pixsim.show.pages import rows_csv
from pixsim.show.render import notebook
from pixsim.show.sentences import span, with_error
from pixsim.studies.paired import FEWEST_PAIRS, Pairs
from pixsim.studies.store import COLUMNS
from pixsim.viewer.metric_registry import METRICS
from pixsim.viewer.metrics import PIXEL_STATISTICS, Metric

RESULTS = {"score.json": "run", "summary.json": "study", "compare.json": "comparison"}
ROWS_FILE = "results.csv"
# What a header of light says of the pixels, not of the light itself.
OF_PIXELS = {"plan", "bound_e", "spare_e", "render_noise"}


@dataclass(frozen=True)
class ResultFolder:
    """A result in a folder.

    path : of the folder
    kind : "run", "study" or "comparison"
    lights : header of each light, by the case or the sensor that sees it
    streams : what its random streams begin with
    rows : of results.csv, by the place of each: labels, size of a study's pixels, repeat, and dots where there are several
    """

    path: Path
    kind: str
    lights: Mapping[str, Mapping[str, Any]] = field(repr=False)
    streams: tuple[object, ...]
    rows: Mapping[tuple[object, ...], Mapping[str, float]] = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.path.resolve().name

    @property
    def columns(self) -> list[str]:
        """Columns of numbers that all rows have."""
        return list(next(iter(self.rows.values())))


def read_folder(path: str | os.PathLike[str]) -> ResultFolder:
    """Return the result in a folder. Raises PixsimError for another folder, and for one of another version of pixsim."""
    folder = Path(path)
    files = [name for name in RESULTS if (folder / name).is_file()]
    allowed = f"the folder of a run, a study or a comparison, with {ROWS_FILE}"
    if not files:
        raise invalid("results", f"'{folder}' without {', '.join(RESULTS)}", allowed)
    if (version := version_of_files(folder)) != VERSION:
        got = f"'{folder}', of pixsim {version}" if version else f"'{folder}', of an unknown version of pixsim"
        raise invalid("results", got, f"results of pixsim {VERSION}", "Make it again, with its settings.toml.")
    if not (folder / ROWS_FILE).is_file():
        hint = "A comparison and a study keep theirs in the folder of --out; a run has written one since pixsim 2.0."
        raise invalid("results", f"'{folder}' without {ROWS_FILE}", allowed, hint)
    try:
        content = json.loads((folder / files[0]).read_text(encoding="utf-8"))
    except ValueError as error:
        raise invalid("results", f"'{folder / files[0]}' ({error})", "JSON") from None
    check_not_newer(f"'{folder / files[0]}'", content.get("schema"))
    kind = RESULTS[files[0]]
    rows = _rows_of(folder / ROWS_FILE, kind)
    if not rows:
        raise invalid("results", f"'{folder / ROWS_FILE}' without rows", allowed)
    return ResultFolder(folder, kind, *_light_and_streams(content, kind), rows)


def _light_and_streams(content: Mapping[str, Any], kind: str) -> tuple[dict[str, Mapping[str, Any]], tuple[object, ...]]:
    """Return the lights of a result by their names, and its random streams."""
    if kind == "run":
        return {"": content["irradiance"]}, ("evaluate", content["seed"])
    if kind == "comparison":
        sensors = content.get("sensors", {})
        return {name: sensor["irradiance"] for name, sensor in sensors.items()}, ("compare", content.get("seed"))
    study = content["study"]
    cases = content.get("cases", [])
    lights = {json.dumps([case.get("at"), case.get("condition")], sort_keys=True): case["irradiance"] for case in cases}
    return lights or {"": content["irradiance"]}, (study.get("streams") or study["name"], study.get("seed", 0))


def _rows_of(path: Path, kind: str) -> dict[tuple[object, ...], dict[str, float]]:
    """Return the numbers of the rows of results.csv by their places."""
    first_number = PIXEL_STATISTICS[0]
    rows: dict[tuple[object, ...], dict[str, float]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        names = list(reader.fieldnames or ())
        if names[:3] != list(COLUMNS[:3]) or first_number not in names:
            raise invalid("results", f"'{path}'", "the rows of a study")
        labels = names[names.index("repeat") + 1 : names.index(first_number)]
        numbers = [name for name in names[names.index(first_number) :] if name != "schema"]
        for row in reader:
            place: list[object] = [(name, row[name]) for name in labels]
            # The sensor of a run is what is compared; the sizes of a comparison are those of its sensors.
            place += [] if kind == "run" else [("technology", row["technology"])]
            place += [("pitch_um", float(row["pitch_um"]))] if kind == "study" else []
            rows[*place, ("repeat", int(row["repeat"]))] = {name: float(row[name] or "nan") for name in numbers}
    return rows


@dataclass(frozen=True)
class ResultPairs:
    """Frames of two results that have all but the result in common.

    place : labels, and size of a study's pixels
    pairs : of a metric, in the order of the repeats
    """

    place: Mapping[str, Any]
    pairs: Pairs

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON; those that one pair does not tell are None."""
        pairs = self.pairs
        is_one = pairs.a.size < FEWEST_PAIRS
        return {
            **self.place,
            "metric": pairs.metric.name,
            "pairs": pairs.a.size,
            "difference": pairs.difference,
            "interval": None if is_one else list(pairs.interval),
            "probability_a_better": None if is_one else pairs.probability_a_better,
        }

    @property
    def sign(self) -> int:
        """1 if the first result is surely better, -1 if the other one is, else 0."""
        pairs = self.pairs
        if pairs.a.size < FEWEST_PAIRS or abs(pairs.difference) <= pairs.half_width:
            return 0
        return int(np.sign(pairs.metric.worse_by(pairs.difference, 0.0)))


@dataclass(frozen=True)
class ResultsComparison:
    """Two results of the same light and random streams, paired frame by frame.

    a, b : the folders
    differences : of each metric at each place that both have
    only_in_one : number of rows that one of them has alone
    """

    a: ResultFolder
    b: ResultFolder
    differences: tuple[ResultPairs, ...]
    only_in_one: int = 0

    @property
    def names(self) -> tuple[str, str]:
        """Names of the folders; with the folders above them where these are the same."""
        if self.a.name != self.b.name:
            return self.a.name, self.b.name
        return str(self.a.path), str(self.b.path)

    @property
    def sentences(self) -> list[str]:
        """One sentence for each metric: which result is better, by how much, and at how many places."""
        sentences = []
        for name in dict.fromkeys(each.pairs.metric.name for each in self.differences):
            of_metric = [each for each in self.differences if each.pairs.metric.name == name]
            sentences.append(_sentence(of_metric, self.names))
        return sentences

    def as_dict(self) -> dict[str, Any]:
        """Return the differences, b minus a, for JSON."""
        rows = [each.as_dict() for each in self.differences]
        return {"names": list(self.names), "verdicts": self.sentences, "differences": rows, "only_in_one": self.only_in_one}

    @checks_arguments
    def to_csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return a row for each metric and place as CSV, and write it to `path` if given."""
        rows = [each.as_dict() for each in self.differences]
        return rows_csv([{name: "" if value is None else value for name, value in row.items()} for row in rows], path)

    def answers(self) -> list[Answer]:
        """Return the sentences as answers."""
        return [Answer((Strong(sentence),)) for sentence in self.sentences]

    def facts(self) -> Iterator[Block]:
        """Yield a table of all differences, and what was not paired."""
        labels = list(dict.fromkeys(name for each in self.differences for name in each.place))
        first, other = self.names
        head = (*labels, "metric", f"{other} − {first}", "95 % interval", f"probability that {first} is better", "pairs")
        rows = []
        for each in self.differences:
            row = each.as_dict()
            is_one = row["interval"] is None
            interval = "" if is_one else span(row["interval"][0], row["interval"][1], "+.4g")
            chance = "" if is_one else f"{row['probability_a_better']:.3f}"
            values = [str(each.place.get(name, "")) for name in labels]
            rows.append((*values, row["metric"], f"{row['difference']:+.4g}", interval, chance, str(row["pairs"])))
        yield DocumentTable("differences", head, rows, words=tuple(range(1, len(labels) + 1)))
        if self.only_in_one:
            yield Listed([f"{self.only_in_one} rows are in one of the results only"])

    def _repr_html_(self) -> str:
        from pixsim.show.document import Document

        return notebook(Document("", "", "", {}, cell=(*self.answers(), *self.facts())))

    def __repr__(self) -> str:
        return f"<ResultsComparison {'; '.join(plain_text(answer.head) for answer in self.answers())}>"


def _sentence(of_metric: list[ResultPairs], names: tuple[str, str]) -> str:
    """Return which of two results is better by a metric."""
    first, metric = of_metric[0].pairs, of_metric[0].pairs.metric
    words = "mean ΔE" if metric.is_delta_e else metric.words
    if len(of_metric) == 1:
        pairs = first
        if not pairs.differences.any():
            return f"{words}: {names[0]} and {names[1]} are the same in every pair of frames"
        unit = f" {metric.unit}" if metric.unit else ""
        better = names[0] if metric.worse_by(pairs.difference, 0.0) > 0 else names[1]
        if pairs.a.size < FEWEST_PAIRS:
            return f"{words}: {better} is better by {abs(pairs.difference):.4g}{unit} in one pair of frames"
        size = with_error(abs(pairs.difference), pairs.half_width)
        worse = names[1] if better == names[0] else names[0]
        if not of_metric[0].sign:
            return f"{words}: {names[0]} and {names[1]} cannot be told apart, {better} is better by {size}{unit}"
        return f"{words}: {better} is better than {worse} by {size}{unit}"
    signs = [each.sign for each in of_metric]
    counts = [f"{name} is better at {signs.count(sign)}" for sign, name in ((1, names[0]), (-1, names[1])) if sign in signs]
    return f"{words}: {', '.join(counts) or 'neither is surely better at any'} of {len(signs)} places"


@checks_arguments
def compare_results(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> ResultsComparison:
    """Compare two results that exist, by their folders: of two runs, two studies or two comparisons.

    a, b : folders that pixsim wrote. Their light and random streams must be the same, so that their frames are pairs

    Raises PixsimError for folders of another kind or of another version of pixsim, and says what of light and streams differs.
    """
    first, other = read_folder(a), read_folder(b)
    if first.kind != other.kind:
        raise invalid("results", f"a {first.kind} and a {other.kind}", "two results of one kind")
    if differing := list(what_differs(first, other)):
        hint = "Compare sensors in one light: pixsim compare A.toml B.toml."
        got = f"two results that differ in {'; '.join(differing)}"
        raise invalid("results", got, "results of the same light and streams", hint)
    shared = [place for place in first.rows if place in other.rows]
    if not shared:
        raise invalid("results", "two results without a row in common", "the same cases, sizes and sensors")
    groups: dict[tuple[object, ...], list[tuple[object, ...]]] = {}
    for place in shared:
        groups.setdefault(place[:-1], []).append(place)

    differences = []
    for metric in metrics_of(first, other):
        column = metric.columns[0]
        for labels, places in groups.items():
            values_a, values_b = (np.array([folder.rows[place][column] for place in places]) for folder in (first, other))
            if np.isfinite([values_a, values_b]).all():
                pairs = Pairs((first.name, other.name), values_a, values_b, metric)
                differences.append(ResultPairs(dict(labels), pairs))  # type: ignore[arg-type]
    only = len(first.rows) + len(other.rows) - 2 * len(shared)
    return ResultsComparison(first, other, tuple(differences), only)


def metrics_of(a: ResultFolder, b: ResultFolder) -> list[Metric]:
    """Return the metrics of which both results have numbers."""
    both = set(a.columns) & set(b.columns)
    return [metric for metric in METRICS.values() if metric.columns[0] in both]


def what_differs(a: ResultFolder, b: ResultFolder) -> Iterator[str]:
    """Yield what of the light and the random streams of two results differs, in words."""
    if a.streams != b.streams:
        yield f"random streams ({_shown(a.streams)} and {_shown(b.streams)})"
    for name in a.lights.keys() & b.lights.keys():
        one, other = ({key: value for key, value in each.lights[name].items() if key not in OF_PIXELS} for each in (a, b))
        for key in sorted(one.keys() | other.keys()):
            if not _same(one.get(key), other.get(key)):
                yield f"the light's {key} ({_shown(one.get(key))} and {_shown(other.get(key))})"


def _same(one: object, other: object) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=0.0) or (math.isnan(one) and math.isnan(other))
    return one == other


def _shown(value: object) -> str:
    return f"{value}"[:60]
