"""The page of a lens: its numbers as tables, and its figures with their data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.digits import UNKNOWN, f_stop, number
from pixsim.base.errors import one_line
from pixsim.base.schema import result_data
from pixsim.base.tables import Column, plain, table_csv
from pixsim.measure.lens import CUT_POINTS, MTF_LINES, LensData, cross_section
from pixsim.report.panels import (
    LEGEND_IN,
    MARKED_LINE,
    Line,
    LinePanel,
    draw_panels,
    legend_below,
    panels_of,
    rows_table,
)
from pixsim.show.document import Answer, Document, DocumentTable, Listed, Plot, Section
from pixsim.show.figures import LINE_STYLES, finish
from pixsim.show.pages import Drawing, coarse_table, figure, figure_files
from pixsim.show.presenter import Presenter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SINGLE_FIELDS = (0, 3, 6, 8)  # of the fields, in figures of single fields
_PSF_HALF_WIDTHS = 2.5  # rms radii of the largest spot, along half a side of the PSFs shown
FIGURES = (
    "layout",
    "spots",
    "psf",
    "mtf",
    "mtf_over_field",
    "field_curvature",
    "illumination",
    "colour",
)
FILES = ("report.html", "summary.json", *figure_files(FIGURES))

_ANGLE = "field angle (degrees)"
_HEIGHT = "image height (mm)"
GLASS: dict[str, Any] = {"facecolor": "#dfe9f2", "edgecolor": "0.35", "lw": 0.9}


@figure("layout", "Layout with rays of three fields, to the image plane.")
def layout(data: LensData) -> Drawing:
    """Draw the glasses, and rays of three fields, in the y-z plane."""
    cut = cross_section(data.lens)
    figure, (axes,) = panels_of(1, 4.1, legend_in=LEGEND_IN)

    # Glasses, each between two surfaces.
    drawn_surfaces = set()
    pairs_of_surfaces = zip(cut.surfaces, cut.surfaces[1:], strict=False)
    for index, ((z, y), (next_z, next_y)) in enumerate(pairs_of_surfaces):
        if cut.glass_behind[index]:
            axes.fill([*z, *next_z[::-1]], [*y, *next_y[::-1]], **GLASS)
            drawn_surfaces |= {index, index + 1}
    surfaces = sorted(drawn_surfaces)
    table: dict[str, Array] = {"surface": np.repeat(np.array(surfaces, int) + 1, CUT_POINTS)}
    table |= rows_table(
        ("surface_z_mm", "surface_y_mm"), [cut.surfaces[index] for index in surfaces]
    )

    # The stop, as the two halves of its screen.
    stop_z_mm, stop_radius_mm = cut.stop
    axes.vlines(
        [stop_z_mm, stop_z_mm],
        [stop_radius_mm, -1.35 * stop_radius_mm],
        [1.35 * stop_radius_mm, -stop_radius_mm],
        color="black",
        lw=2.5,
        label="stop",
    )

    rays = []
    for (angle_deg, field_rays), line_style in zip(cut.rays.items(), LINE_STYLES, strict=False):
        for number_of_ray, (height, z, y) in enumerate(field_rays):
            label = None if number_of_ray else f"{angle_deg:.3g}°"
            axes.plot(z, y, lw=0.8, label=label, **line_style.stroke)
            rays.append((angle_deg, height, z, y))
    table |= rows_table(("field_deg", "stop_y", "z_mm", "y_mm"), rays)

    largest_mm = max(float(np.abs(data.curves["image_height_mm"]).max()), stop_radius_mm)
    image_height_mm = 1.05 * largest_mm
    axes.vlines(cut.length_mm, -image_height_mm, image_height_mm, color="black", lw=1.2)
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, "z (mm from the first surface)", "y (mm)", None)
    legend_below(figure, axes, len(cut.rays) + 1)
    return figure, table


def _single_fields(data: LensData) -> list[int]:
    return [index for index in _SINGLE_FIELDS if index < data.field_deg.size]


def _field_panels(
    data: LensData, height_in: float, legend_in: float = 0.0
) -> tuple[Figure, dict[int, Axes]]:
    """Return a figure and the axes of the image plane at some fields, by their numbers."""
    fields = _single_fields(data)
    figure, row = panels_of(len(fields), height_in, shared=True, legend_in=legend_in)
    for axes, index in zip(row, fields, strict=True):
        words = "no light" if data.dark[index] else f"rms {data.spots[index].rms_um:.3g} µm"
        axes.set_title(f"{data.field_deg[index]:.3g}°: {words}", fontsize=9)
        axes.set_xlabel("x (µm)")
    row[0].set_ylabel("y (µm)")
    return figure, dict(zip(fields, row, strict=True))


@figure("spots", "Spots around the chief ray; y points away from the axis.")
def _spot_plate(data: LensData) -> Drawing:
    """Draw the spots of some fields on one scale, with the first dark ring of diffraction."""
    from matplotlib.patches import Circle

    figure, panels = _field_panels(data, 2.9, LEGEND_IN)
    rays = []
    for index, axes in panels.items():
        spot = data.spots[index]
        for nm, x, y, line_style in zip(
            data.wavelength_nm, spot.x_um, spot.y_um, (*LINE_STYLES, *LINE_STYLES), strict=False
        ):
            axes.plot(
                x, y, line_style.marker, ms=2, color=line_style.colour, mew=0, label=f"{nm:.4g} nm"
            )
            rays.append((data.field_deg[index], nm, x, y))
        axes.add_patch(
            Circle((0.0, 0.0), data.airy_um, fill=False, color="black", lw=0.9, label="Airy disc")
        )
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)

    table = rows_table(("field_deg", "wavelength_nm", "x_um", "y_um"), rays)
    limit_um = 1.1 * float(
        np.fmax.reduce(np.abs([*table["x_um"], *table["y_um"]]), initial=data.airy_um)
    )
    panels[0].set(xlim=(-limit_um, limit_um), ylim=(-limit_um, limit_um))
    legend_below(figure, panels[0], 6)
    return figure, table


@figure(
    "psf",
    "Point spread functions: the square root of the irradiance over its maximum. The table has"
    " block means.",
)
def _psf_plate(data: LensData) -> Drawing:
    """Show the point spread functions of some fields on one scale."""
    figure, panels = _field_panels(data, 2.7)
    largest_um = max(data.spots[index].rms_um for index in panels if not data.dark[index])
    half_um = max(
        _PSF_HALF_WIDTHS * largest_um, 4e-3 * data.lens.primary_nm * data.lens.working_f_number
    )
    cells = min(
        math.ceil(half_um / data.psf_pitch_um),
        *(len(data.psfs[index]) // 2 - 1 for index in panels),
    )
    half_side_um = (2 * cells + 1) * data.psf_pitch_um / 2
    table: dict[str, Column] = {}
    for index, axes in panels.items():
        middle = len(data.psfs[index]) // 2
        inside = slice(middle - cells, middle + cells + 1)
        psf = np.maximum(data.psfs[index][inside, inside], 0.0)
        psf = psf / max(float(psf.max()), np.finfo(float).tiny)
        axes.imshow(
            np.sqrt(psf),
            cmap="viridis",
            vmin=0,
            vmax=1,
            origin="lower",
            extent=(-half_side_um, half_side_um, -half_side_um, half_side_um),
        )
        table |= coarse_table(psf, f"psf_{data.field_deg[index]:.4g}_deg")
    return figure, table


def _mtf_lines(
    table: dict[str, Array], x: str, curves: Sequence[tuple[str, str, Array]]
) -> list[Line]:
    """Return the lines of tangential and sagittal MTFs, and add them to a table.

    curves : words for the legend, the end of the columns' names, and both MTFs, (2, n), of each
    """
    lines = []
    for (words, column_end, tangential_sagittal), line_style in zip(
        curves, LINE_STYLES, strict=False
    ):
        for name, mtf, dashes in zip(
            MTF_LINES, tangential_sagittal, ("-", (0, (4, 2))), strict=True
        ):
            table[f"{name}_{column_end}"] = mtf
            lines.append(
                Line(
                    x, f"{name}_{column_end}", f"{words} {name}", {**line_style.line, "ls": dashes}
                )
            )
    return lines


@figure("mtf", "MTF: tangential (lines across the radius) and sagittal (lines along it).")
def _mtf_plate(data: LensData) -> Drawing:
    """Plot the MTF of some fields against frequency, and the limit of diffraction."""
    table = {"frequency_lp_per_mm": data.frequency_lp_per_mm, "diffraction": data.diffraction_mtf}
    angles = {index: data.field_deg[index] for index in _single_fields(data)}
    curves = [
        (f"{angle:.3g}°", f"{angle:.4g}_deg", data.mtf[index]) for index, angle in angles.items()
    ]
    lines = _mtf_lines(table, "frequency_lp_per_mm", curves)
    lines.append(Line("frequency_lp_per_mm", "diffraction", "diffraction, on the axis"))
    nyquist = (
        {} if data.pitch_um is None else {f"Nyquist of {data.pitch_um:g} µm": 500 / data.pitch_um}
    )
    limits = {"xlim": (0, data.frequency_lp_per_mm[-1]), "ylim": (0, 1.02)}
    return draw_panels(
        table,
        [LinePanel("frequency (line pairs/mm)", "MTF", lines, nyquist, limits)],
        legend_columns=5,
    )


@figure("mtf_over_field", "MTF against image height.")
def _mtf_over_field(data: LensData) -> Drawing:
    """Plot the MTF at the frequencies of the tables against image height."""
    table = {"field_deg": data.field_deg, "image_height_mm": data.height_mm}
    curves = [
        (f"{frequency:.4g} lp/mm", f"{frequency:.4g}", data.mtf_at(frequency).T)
        for frequency in data.asked_lp_per_mm
    ]
    lines = _mtf_lines(table, "image_height_mm", curves)
    return draw_panels(
        table,
        [LinePanel(_HEIGHT, "MTF", lines, axes={"ylim": (0, 1.02)})],
        legend_columns=len(curves),
    )


CURVES = {
    "field_curvature": (
        LinePanel(
            _ANGLE,
            "focus behind the image plane (mm)",
            (
                Line("field_deg", "tangential_focus_mm", "tangential", MARKED_LINE),
                Line("field_deg", "sagittal_focus_mm", "sagittal", MARKED_LINE),
            ),
        ),
        LinePanel(_ANGLE, "distortion (%)", (Line("field_deg", "distortion_percent"),)),
    ),
    "illumination": (
        LinePanel(
            _HEIGHT,
            "relative illumination",
            (
                Line("image_height_mm", "relative_illumination", "traced", MARKED_LINE),
                Line("image_height_mm", "cos4", "cos⁴ of the field angle", MARKED_LINE),
            ),
            axes={"ylim": (0, 1.05)},
        ),
        LinePanel(
            _HEIGHT, "chief ray angle (degrees)", (Line("image_height_mm", "chief_ray_angle_deg"),)
        ),
    ),
    "colour": (
        LinePanel(_ANGLE, "lateral colour (µm)", (Line("field_deg", "lateral_colour_um"),)),
        LinePanel(
            "wavelength (nm)",
            "shift of the paraxial focus (µm)",
            (Line("wavelength_nm", "focus_um"),),
        ),
    ),
}


def _curve_drawing(data: LensData, name: str) -> Drawing:
    """Draw two panels of curves over the field or the wavelengths."""
    nm, focus_um = data.axial_colour()
    curves = {
        "field_deg": data.curve_deg,
        **data.curves,
        "distortion_percent": 100 * data.curves["distortion"],
        "cos4": np.cos(np.radians(data.curve_deg)) ** 4,
        "wavelength_nm": nm,
        "focus_um": focus_um,
    }
    columns = [
        "field_deg",
        *(column for panel in CURVES[name] for line in panel.lines for column in line[:2]),
    ]
    return draw_panels({column: curves[column] for column in columns}, CURVES[name], 3.2)


@figure(
    "field_curvature", "Foci of rays near the chief ray; distortion relative to a very small image."
)
def _curvature_plate(data: LensData) -> Drawing:
    """Plot the tangential and sagittal foci and the distortion against the field angle."""
    return _curve_drawing(data, "field_curvature")


@figure("illumination", "Relative illumination, and chief ray angle in image space.")
def _illumination_plate(data: LensData) -> Drawing:
    """Plot the relative illumination and the chief ray angle against image height."""
    return _curve_drawing(data, "illumination")


@figure(
    "colour",
    "Heights of chief rays, longest minus shortest wavelength; paraxial focus relative to that of"
    " the primary wavelength.",
)
def _colour_plate(data: LensData) -> Drawing:
    """Plot the lateral colour against the field, and the paraxial focus against wavelength."""
    return _curve_drawing(data, "colour")


# --- The document


def lens_document(data: LensData) -> Document:
    """Return the page of a lens: its layout, first-order data and fields, and further figures."""
    prescription = data.lens.prescription
    over_field = (
        (_mtf_over_field, _curvature_plate, _illumination_plate) if data.field_deg.size > 1 else ()
    )
    figures = _spot_plate, _psf_plate, _mtf_plate, *over_field, _colour_plate
    source = (
        f"Source: {prescription.source or 'not stated'}. Radius of the stop:"
        f" {data.lens.stop_semi_diameter_mm:.5g} mm."
    )
    glasses = (
        *(f"glass {glass.name}: {glass.source}" for glass in prescription.glasses),
        (
            f"uncoated surfaces would reflect {data.loss_percent:.3g} % of the light on the axis;"
            " camera.transmittance is what counts"
        ),
    )
    return Document(
        command="lens",
        kind="lens",
        title=prescription.name,
        data=_lens_values(data),
        answers=(Answer(_title_of(data), (prescription.title,), named=True),),
        lead=(Plot(partial(layout, data)), *data.notes),
        sections=(
            Section("first-order", "First-order data", (_first_order_table(data),), brief=True),
            Section("fields", "Fields", (_field_table(data),), brief=True),
            Section("figures", "Figures", [Plot(partial(draw, data)) for draw in figures]),
            Section("glasses", "Glasses", (Listed(glasses),), folded=True, brief=True),
            Section(
                "reflections",
                "Reflected twice",
                (_ghost_table(data),) if data.ghosts else (),
                folded=True,
            ),
            Section("made", "How this was computed", (source,), folded=True),
        ),
    )


_LENS_NUMBERS = (
    "primary_nm",
    "max_field_deg",
    "object_distance_mm",
    "stop_semi_diameter_mm",
    "working_f_number",
)


def _lens_values(data: LensData) -> dict[str, Any]:
    """Return summary.json."""
    lens = data.lens
    prescription = data.lens.prescription
    content = {
        **{name: getattr(prescription, name) for name in ("name", "title", "source")},
        **{name: getattr(lens, name) for name in _LENS_NUMBERS},
        "image_distance_mm": prescription.surfaces[-1].thickness_mm,
        "fresnel_transmittance": lens.fresnel_transmittance(lens.primary_nm),
        "reflectance": data.reflectance,
        "reflected_twice": [plain(vars(ghost)) for ghost in data.ghosts],
        "pitch_um": data.pitch_um,
        "mtf_of": "rays times the limit of diffraction" if data.geometric else "waves",
        "first_order": [
            plain({"wavelength_nm": nm, **vars(order)})
            for nm, order in zip(data.wavelength_nm.tolist(), data.first, strict=True)
        ],
        "glasses": [{"name": glass.name, "source": glass.source} for glass in prescription.glasses],
        "fields": _field_values(data),
    }
    settings = {
        "lens": {"file": prescription.name, "primary_nm": lens.primary_nm},
        "pixel": {"pitch_um": data.pitch_um},
    }
    return result_data(plain(content), settings=settings, notes=data.notes)


def _field_columns(data: LensData) -> dict[str, Array]:
    """Return the columns of a row for each field: heights, spots, wavefronts and traced curves."""
    columns = {
        "field_deg": data.field_deg,
        "height_mm": data.height_mm,
        "rms_spot_um": np.array([spot.rms_um for spot in data.spots]),
        "rms_wavefront_waves": data.rms_waves,
    }
    return columns | {
        name: np.interp(data.field_deg, data.curve_deg, curve)
        for name, curve in data.curves.items()
    }


def _field_values(data: LensData) -> list[dict[str, Any]]:
    """Return a row for each field, with its MTF at the frequencies of the tables."""
    columns = _field_columns(data)
    rows = [
        plain(dict(zip(columns, row, strict=True)))
        for row in np.column_stack([*columns.values()]).tolist()
    ]
    for index, row in enumerate(rows):
        mtfs = {
            frequency: dict(zip(MTF_LINES, data.mtf_at(frequency)[index].tolist(), strict=True))
            for frequency in data.asked_lp_per_mm
        }
        row["mtf"] = [{"lp_per_mm": frequency} | plain(mtf) for frequency, mtf in mtfs.items()]
    return rows


def _lens_csv(data: LensData) -> str:
    """Return a row for each field as CSV."""
    columns = _field_columns(data) | {
        f"mtf_{name}_{frequency:.4g}_lp_per_mm": mtf
        for frequency in data.asked_lp_per_mm
        for name, mtf in zip(MTF_LINES, data.mtf_at(frequency).T, strict=True)
    }
    return table_csv({name: values.tolist() for name, values in columns.items()})


def _title_of(data: LensData) -> str:
    """Return the line that names a lens, with its focal length, f-number, field and object."""
    lens = data.lens
    first = data.primary
    if math.isinf(lens.object_distance_mm):
        object_place = "infinity"
    else:
        object_place = f"{lens.object_distance_mm / 1e3:.4g} m"
    return (
        f"{one_line(lens.prescription.name)}: f = {first.focal_length_mm:.5g} mm,"
        f" {f_stop(first.f_number)}, fields to {lens.max_field_deg:.4g}°, image heights to"
        f" {data.height_mm.max():.4g} mm, object at {object_place}"
    )


# Digits that tell wavelengths apart; rays are exact.
_FIRST_ORDER_DIGITS = 5
_FIRST_ORDER = {
    "focal_length_mm": "focal length (mm)",
    "back_focal_length_mm": "back focal length (mm)",
    "entrance_pupil_diameter_mm": "entrance pupil, diameter (mm)",
    "entrance_pupil_from_first_vertex_mm": "entrance pupil, behind the first surface (mm)",
    "exit_pupil_diameter_mm": "exit pupil, diameter (mm)",
    "exit_pupil_from_image_mm": "exit pupil, behind the image plane (mm)",
    "f_number": "f-number",
}


def _first_order_table(data: LensData) -> DocumentTable:
    """Return the first-order data, with a column for each wavelength."""
    head = ("", *(f"{nm:.5g} nm" for nm in data.wavelength_nm))
    rows = [
        (words, *(number(getattr(order, name), _FIRST_ORDER_DIGITS) for order in data.first))
        for name, words in _FIRST_ORDER.items()
    ]
    return DocumentTable("first-order data", head, rows, "Paraxial, with the object at infinity")


_FIELD_DIGITS = 3
_FIELD_HEADS = {
    "field_deg": "field\n°",
    "height_mm": "height\nmm",
    "chief_ray_angle_deg": "chief ray\n°",
    "distortion_percent": "distortion\n%",
    "relative_illumination": "illumination\n",
    "rms_spot_um": "spot\nµm rms",
    "rms_wavefront_waves": "wavefront\nwaves rms",
}


def _field_table(data: LensData) -> DocumentTable:
    """Return heights, distortion, spots, wavefronts and MTFs of every second field."""
    columns = _field_columns(data)
    columns["distortion_percent"] = 100 * columns["distortion"]
    cells = [[number(value, _FIELD_DIGITS) for value in columns[name]] for name in _FIELD_HEADS]
    for frequency in data.asked_lp_per_mm:
        tangential_sagittal = data.mtf_at(frequency)
        cells.append(
            [UNKNOWN if math.isnan(t) else f"{t:.2f}/{s:.2f}" for t, s in tangential_sagittal]
        )
    heads = (
        *_FIELD_HEADS.values(),
        *(f"MTF {frequency:.4g}/mm\nt/s" for frequency in data.asked_lp_per_mm),
    )
    caption = (
        f"Spots and MTF (tangential/sagittal) of {'rays' if data.geometric else 'waves'} of all"
        f" wavelengths with equal weights, all else of {data.lens.primary_nm:.5g} nm; the wavefront"
        " is without tilt"
    )
    return DocumentTable("fields", heads, list(zip(*cells, strict=True))[::2], caption)


_MAX_GHOSTS = 5


def _ghost_table(data: LensData) -> DocumentTable:
    """Return the pairs of surfaces that reflect most light twice, and the pair that focuses it
    nearest to the sensor.
    """
    ghosts = dict.fromkeys([*data.ghosts[:_MAX_GHOSTS], data.focused_ghost])
    rows = [
        (
            f"{ghost.surfaces[0]} and {ghost.surfaces[1]}",
            *(
                number(value, 3)
                for value in (100 * ghost.share, ghost.focus_from_image_mm, ghost.blur_mm)
            ),
        )
        for ghost in ghosts
        if ghost
    ]
    head = (
        "surfaces",
        "share of the light (%)",
        "focus behind the image plane (mm)",
        "disc of a point (mm)",
    )
    total = sum(ghost.share for ghost in data.ghosts)
    if data.reflectance is None:
        coating = "bare glass"
    else:
        coating = f"a coating that reflects {100 * data.reflectance:.3g} %"
    caption = (
        f"Light on the axis: {100 * total:.3g} % by all pairs, with {coating}, the nearest focus"
        " last"
    )
    return DocumentTable("reflected-twice", head, rows, caption)


PRESENTER = Presenter(document=lens_document, figure=layout, csv=_lens_csv)
