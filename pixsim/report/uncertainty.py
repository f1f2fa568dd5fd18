"""The distribution of each optimum over sensor types, and the shares of its variance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

from pixsim.base.digits import percent
from pixsim.sensor.labels import label_of
from pixsim.show.document import Block, DocumentTable, Fact, Link, Plot, Section, headline
from pixsim.show.figures import COLOURS, literal, new_figure
from pixsim.show.pages import Drawing, Plate, figure, figure_files
from pixsim.show.sentences import capital
from pixsim.studies.uncertainty import SCATTER, PairUncertainty, Sample, UncertaintyResult

_MAX_BARS = 30  # of a histogram
_MAX_SECTIONS = 20  # technologies × values × conditions with a section of the page
_TYPES_EXPLAINED = (
    "Numbers of the sensor that are known only within a range are drawn at random from it, all at"
    " once. Each draw is a sensor type; the study finds its optimum. All types have the same random"
    " numbers, so that they differ by their inputs only. "
)
_SHARES_EXPLAINED = (
    "Shares of the variance that inputs explain, each with its standard error. The share of the"
    " scatter is an upper bound: the interval of each type's optimum includes errors that all"
    " types have in common."
)


def uncertainty_files() -> set[str]:
    """Return the names of all files that the results of sensor types may have."""
    numbers = range(1, _MAX_SECTIONS + 1)
    figures = figure_files([f"uncertainty_distribution_{number}" for number in numbers])
    return {*figures, *(f"sensor_types_{number}.csv" for number in numbers)}


def uncertainty_sections(results: Sequence[UncertaintyResult]) -> Iterator[Section]:
    """Yield a section for each optimum over sensor types: its distribution, and the shares of its
    variance.
    """
    for number, result in enumerate(results[:_MAX_SECTIONS], 1):
        title = f"Sensor types: {capital(result.label) or 'optimum'}{result.by}"
        distribution_plot = Plot(partial(_numbered_plate, result, number))
        types = (Link("All sensor types (CSV)", f"sensor_types_{number}.csv"),)
        yield Section(
            f"types-{number}",
            title,
            (_TYPES_EXPLAINED, distribution_plot, _SHARES_EXPLAINED, shares_table(result), types),
        )


def _numbered_plate(result: UncertaintyResult, number: int) -> Plate:
    return distribution_plate(result).named(f"uncertainty_distribution_{number}")


def uncertainty_csv(results: Sequence[UncertaintyResult]) -> dict[str, str]:
    """Return a file of the sensor types of each optimum, name -> CSV."""
    return {
        f"sensor_types_{number}.csv": result.to_csv()
        for number, result in enumerate(results[:_MAX_SECTIONS], 1)
    }


def shares_table(result: UncertaintyResult) -> DocumentTable:
    """Return the shares of the variance of both results that inputs explain alone, and with all
    interactions if known.
    """
    head = ["input"]
    for name in ("optimal size", result.metric.best):
        head += (
            [f"{name}: alone", f"{name}: with all interactions"]
            if result.total
            else [f"{name}: alone"]
        )
    labels = _input_labels(result.sample) | {SCATTER: SCATTER}
    rows = [
        (
            label,
            *(str(share) for shares in result.shares.values() for share in shares[name].values()),
        )
        for name, label in labels.items()
    ]
    return DocumentTable("shares of the variance", head, rows, words=None)


@figure(
    "uncertainty_distribution",
    "Numbers of sensor types by their optimal pixel size (left) and their best value (right)."
    " Vertical lines: the median; grey: nine tenths. An optimum at an end of the sizes tried counts"
    " as that size.",
)
def distribution_plate(result: UncertaintyResult) -> Drawing:
    """Plot histograms of the optimum and of the least ΔE, or of the best value, over the sensor
    types.
    """
    figure = new_figure(9.0, 3.2)
    unit = f" ({result.metric.unit})" if result.metric.unit else ""
    distributions = {
        "optimal pixel size (µm)": result.optimum,
        f"{result.metric.best}{unit}": result.least_delta_e,
    }
    for axes, (title, distribution) in zip(
        figure.subplots(1, 2), distributions.items(), strict=True
    ):
        low, median, high = distribution.quantiles.values()
        axes.axvspan(low, high, color="0.9", lw=0)
        axes.hist(
            distribution.values,
            bins=_MAX_BARS if result.draws > _MAX_BARS**2 else "sqrt",
            color=COLOURS[0],
            edgecolor="white",
        )
        axes.axvline(median, color="0.2", lw=1.2)
        axes.set(xlabel=literal(title), ylabel="sensor types")
        axes.locator_params(axis="y", integer=True)  # counts
    return figure, {column: result.table[column] for column in (*result.outputs, "inside")}


def uncertainty_blocks(results: Sequence[UncertaintyResult]) -> tuple[Block, ...]:
    """Return the quantiles of each optimum, and the probabilities of all verdicts."""
    blocks: list[Block] = []
    for result in results:
        low, median, high = (f"{size_um:.2f} µm" for size_um in result.optimum.quantiles.values())
        name = f"{result.label}: " if result.label else ""
        types = f"{result.draws} sensor types"
        if result.share_at_ends:
            at_ends = f"{percent(result.share_at_ends)} at an end of the sizes tried"
        else:
            at_ends = ""
        blocks.append(
            headline(
                [
                    (
                        f"{name}optimum{result.by} of {types}: median {median}, nine tenths from"
                        f" {low} to {high}"
                    ),
                    at_ends,
                ]
            )
        )
        blocks += [
            Fact(f"{name}probability{result.by} that {statement}: {probability}")
            for statement, probability in result.verdicts.items()
        ]
    return tuple(blocks)


def pair_words(distribution: PairUncertainty) -> str:
    """Return how probably the first of two sensors is better over sensor types, their difference,
    and what matters most.
    """
    first, other = distribution.names
    better = distribution.probability_a_better
    metric = distribution.metric
    low, middle, high = (f"{value:+.2g}" for value in distribution.difference.quantiles.values())
    judge = "" if metric.is_delta_e else f"{metric.words}: "
    unit = " ΔE" if metric.is_delta_e else metric.unit and f" {metric.unit}"
    return (
        f"{judge}over {better.draws} sensor types {first} is better than {other} with probability"
        f" {better}; difference {middle}{unit} in the median, nine tenths from {low} to {high};"
        f" {_largest_share_words(distribution)}"
    )


def _largest_share_words(distribution: PairUncertainty) -> str:
    """Return the unknown number with the largest share of the variance of a difference."""
    shares = {
        label: distribution.shares[name]["first"]
        for name, label in _input_labels(distribution.sample).items()
    }
    shares = {label: share for label, share in shares.items() if not math.isnan(share.share)}
    if not shares:
        return "no number explains the difference, which does not vary or has too few sensor types"
    name = max(shares, key=lambda label: shares[label].share)
    return f"{name} matters most, with {shares[name]} of the variance"


def _input_labels(sample: Sample) -> dict[str, str]:
    """Return the names of the inputs for readers: a technology by its label, not the path of its
    file, where that is unique.
    """
    labels = {}
    for name, members in sample.inputs.items():
        technology = members[0].technology
        labels[name] = name.replace(technology, label_of(technology), 1) if technology else name
    texts = list(labels.values())
    return {name: label if texts.count(label) == 1 else name for name, label in labels.items()}
