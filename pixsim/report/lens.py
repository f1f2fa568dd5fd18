"""The page of a lens: its numbers as tables and sentences, and its figures with their data."""

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
from pixsim.base.tables import Column, plain, rows_csv
from pixsim.measure.lens import MTF_LINES, LensData, cross_section
from pixsim.show.document import Answer, Document, DocumentTable, Listed, Plot, Section, made_with
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, finish, new_figure
from pixsim.show.pages import Drawing, coarse_table, figure, figure_files
from pixsim.show.presenter import Presenter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = (0, 3, 6, 8)  # of the fields, in figures of single fields
SHOWN_HALF_WIDTHS = 2.5  # rms radii of the largest spot, along half a side of the PSFs shown
FIGURES = ("layout", "spots", "psf", "mtf", "mtf_over_field", "field_curvature", "illumination", "colour")
FILES = ("report.html", "summary.json", *figure_files(FIGURES))


WIDTH_IN = 8.6
TICKS = 10  # at most, along the whole width
# Beside the axes and between them there is room for the labels of six characters, such as -0.025, and the name of the axis.
LEFT_IN, RIGHT_IN, BOTTOM_IN, TOP_IN, BETWEEN_IN, LEGEND_IN = 0.85, 0.2, 0.5, 0.28, 0.9, 0.35
BETWEEN_SHARED_IN, TICKS_SHARED = 0.4, 4  # of panels that share their scales: labels at their ends do not meet


def panels_of(count: int, height_in: float, shared: bool = False, legend_below: bool = False) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes in one row, at fixed places: computing them takes as long as to draw the figure.

    shared : whether they share their scales, and the labels of y
    """
    figure = new_figure(WIDTH_IN, height_in)
    figure.set_layout_engine(None)
    row = figure.subplots(1, count, squeeze=False, sharex=shared, sharey=shared)[0]
    between = BETWEEN_SHARED_IN if shared else BETWEEN_IN
    panel_in = (WIDTH_IN - LEFT_IN - RIGHT_IN - (count - 1) * between) / count
    below = BOTTOM_IN + (LEGEND_IN if legend_below else 0.0)
    sides = {"left": LEFT_IN / WIDTH_IN, "right": 1 - RIGHT_IN / WIDTH_IN, "wspace": between / panel_in}
    figure.subplots_adjust(bottom=below / height_in, top=1 - TOP_IN / height_in, **sides)
    for axes in row:
        axes.locator_params(nbins=TICKS_SHARED if shared else TICKS // 2 if count > 1 else TICKS)
    return figure, list(row)


def below(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend below the axes."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="lower center", ncols=columns, frameon=False, fontsize=8, handlelength=LEGEND_LINE
    )


@figure(
    "layout",
    "Layout with rays of three fields through the centre of the stop, its edges and halfway between. Light travels "
    "to the right, to the image plane.",
)
def layout(data: LensData) -> Drawing:
    """Draw the surfaces and rays of three fields in the y-z plane."""
    cut = cross_section(data.lens)
    figure, (axes,) = panels_of(1, 4.1, legend_below=True)
    table: dict[str, list[float | str]] = {"field_deg": [], "stop_y": [], "z_mm": [], "y_mm": []}
    table |= {"surface": [], "surface_z_mm": [], "surface_y_mm": []}
    for index, ((z, y), is_glass) in enumerate(zip(cut.surfaces, cut.glass_behind, strict=True)):
        if is_glass and index + 1 < len(cut.surfaces):
            far_z, far_y = cut.surfaces[index + 1]
            axes.fill(np.concatenate([z, far_z[::-1]]), np.concatenate([y, far_y[::-1]]), color="#dfe9f2", lw=0)
            for end in (0, -1):
                axes.plot([z[end], far_z[end]], [y[end], far_y[end]], color="0.35", lw=0.8)
        if is_glass or (index > 0 and cut.glass_behind[index - 1]):
            axes.plot(z, y, color="0.35", lw=0.9)
            table["surface"] += [index + 1] * z.size
            table["surface_z_mm"] += z.tolist()
            table["surface_y_mm"] += y.tolist()
    at, semi = cut.stop
    for sign in (1, -1):
        axes.plot([at, at], [sign * semi, sign * 1.35 * semi], color="black", lw=2.5, label="stop" if sign > 0 else None)
    for (angle, rays), look in zip(cut.rays.items(), LOOKS, strict=False):
        for index, (height, z, y) in enumerate(rays):
            axes.plot(z, y, color=look.colour, lw=0.8, ls=look.dashes, label=None if index else f"{angle:.3g}°")
            table["field_deg"] += [angle] * z.size
            table["stop_y"] += [height] * z.size
            table["z_mm"] += z.tolist()
            table["y_mm"] += y.tolist()
    image = max(float(np.abs(data.curves["image_height_mm"]).max()), semi)
    axes.plot([cut.length_mm] * 2, [-1.05 * image, 1.05 * image], color="black", lw=1.2)
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, "z (mm from the first surface)", "y (mm)", None)
    below(figure, axes, len(cut.rays) + 1)
    return figure, table


def shown_fields(data: LensData) -> list[int]:
    return [index for index in SHOWN if index < data.field_deg.size]


@figure(
    "spots",
    "Spots: where rays meet the image plane, from the chief ray of the primary wavelength; y points away from the "
    "axis. The circle is the first dark ring of diffraction.",
)
def spot_plate(data: LensData) -> Drawing:
    """Draw the spots of some fields on one scale, with the diameter of the Airy disc."""
    from matplotlib.patches import Circle

    shown = shown_fields(data)
    figure, panels = panels_of(len(shown), 2.9, shared=True, legend_below=True)
    airy = data.airy_um
    table: dict[str, list[float | str]] = {"field_deg": [], "wavelength_nm": [], "x_um": [], "y_um": []}
    most = airy
    for axes, index in zip(panels, shown, strict=True):
        spot, angle = data.spots[index], data.field_deg[index]
        for nm, x, y, look in zip(data.wavelength_nm, spot.x_um, spot.y_um, (*LOOKS, *LOOKS), strict=False):
            axes.plot(x, y, look.marker, ms=2, color=look.colour, mew=0, label=f"{nm:.4g} nm")
            table["field_deg"] += [float(angle)] * x.size
            table["wavelength_nm"] += [float(nm)] * x.size
            table["x_um"] += x.tolist()
            table["y_um"] += y.tolist()
            most = max(most, float(np.max(np.abs([x, y]), initial=0.0, where=np.isfinite([x, y]))))
        axes.add_patch(Circle((0.0, 0.0), airy, fill=False, color="black", lw=0.9, label="Airy disc"))
        rms = "no light" if data.dark[index] else f"rms {spot.rms_um:.3g} µm"
        axes.set_title(f"{angle:.3g}°: {rms}", fontsize=9)
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)
        axes.set_xlabel("x (µm)")
    panels[0].set(ylabel="y (µm)", xlim=(-1.1 * most, 1.1 * most), ylim=(-1.1 * most, 1.1 * most))
    below(figure, panels[0], 6)
    return figure, table


@figure(
    "psf",
    "Point spread functions of the wavelengths together: the square root of the irradiance over its maximum. The "
    "table has means over blocks.",
)
def psf_plate(data: LensData) -> Drawing:
    """Show the point spread functions of some fields on one scale."""
    shown = shown_fields(data)
    largest = max(data.spots[index].rms_um for index in shown if not data.dark[index])
    half = max(SHOWN_HALF_WIDTHS * largest, 4e-3 * data.lens.primary_nm * data.lens.working_f_number)
    figure, panels = panels_of(len(shown), 2.7, shared=True)
    table: dict[str, Column] = {}
    pictures = []
    for index in shown:
        psf = np.maximum(data.psfs[index], 0.0)
        reach, middle = min(math.ceil(half / data.psf_pitch_um), len(psf) // 2 - 1), len(psf) // 2
        pictures.append(psf[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1])
    reach = min(len(picture) // 2 for picture in pictures)
    side = (2 * reach + 1) * data.psf_pitch_um / 2
    for axes, index, picture in zip(panels, shown, pictures, strict=True):
        middle = len(picture) // 2
        cut = picture[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
        cut = cut / max(float(cut.max()), np.finfo(float).tiny)
        axes.imshow(np.sqrt(cut), cmap="viridis", vmin=0, vmax=1, origin="lower", extent=(-side, side, -side, side))
        axes.set_title(f"{data.field_deg[index]:.3g}°{': no light' * bool(data.dark[index])}", fontsize=9)
        axes.set_xlabel("x (µm)")
        coarse = coarse_table(cut, f"psf_{data.field_deg[index]:.4g}_deg")
        table |= coarse
    panels[0].set_ylabel("y (µm)")
    return figure, table


@figure("mtf", "MTF of the wavelengths together: tangential (lines across the radius) and sagittal (lines along it).")
def mtf_plate(data: LensData) -> Drawing:
    """Plot the MTF of some fields against frequency, and the limit of diffraction."""
    figure, (axes,) = panels_of(1, 4.4, legend_below=True)
    figure.subplots_adjust(bottom=0.9 / 4.4 + 0.04)
    frequency = data.frequency_lp_per_mm
    table: dict[str, Column] = {"frequency_lp_per_mm": frequency.tolist()}
    for index, look in zip(shown_fields(data), LOOKS, strict=False):
        angle = data.field_deg[index]
        for kind, mtf, dashes in zip(MTF_LINES, data.mtf[index], ("-", (0, (4, 2))), strict=True):
            axes.plot(
                frequency, mtf, color=look.colour, ls=dashes, marker=look.marker, markevery=10, ms=4, lw=1.2,
                label=f"{angle:.3g}° {kind}",
            )  # fmt: skip
            table[f"{kind}_{angle:.4g}_deg"] = mtf.tolist()
    limit = data.diffraction_mtf
    axes.plot(frequency, limit, color="0.5", lw=1, ls=":", label="diffraction, on the axis")
    table["diffraction"] = limit.tolist()
    if data.pitch_um is not None:
        axes.axvline(500 / data.pitch_um, color="0.5", lw=0.8, ls=(0, (6, 2, 1, 2)), label=f"Nyquist of {data.pitch_um:g} µm")
    axes.set(xlim=(0, frequency[-1]), ylim=(0, 1.02))
    finish(axes, "frequency (line pairs/mm)", "MTF", None)
    below(figure, axes, 5)
    return figure, table


@figure("mtf_over_field", "MTF against image height. Solid: tangential; dashed: sagittal.")
def mtf_over_field(data: LensData) -> Drawing:
    """Plot the MTF at the asked frequencies against image height."""
    figure, (axes,) = panels_of(1, 4.0, legend_below=True)
    figure.subplots_adjust(bottom=0.9 / 4.0 + 0.04)
    height = data.height_mm
    table: dict[str, Column] = {"field_deg": data.field_deg.tolist(), "image_height_mm": height.tolist()}
    for frequency, look in zip(data.asked_lp_per_mm, LOOKS, strict=False):
        tangential, sagittal = data.mtf_at(frequency).T
        nyquist = data.pitch_um is not None and math.isclose(frequency, 500 / data.pitch_um)
        words = f"{frequency:.4g} lp/mm{' (Nyquist)' if nyquist else ''}"
        axes.plot(height, tangential, color=look.colour, ls="-", marker=look.marker, ms=4, lw=1.2, label=f"{words}, tangential")
        axes.plot(
            height, sagittal, color=look.colour, ls=(0, (4, 2)), marker=look.marker, ms=4, lw=1.2, label="sagittal", mfc="white"
        )
        table[f"tangential_{frequency:.4g}"] = tangential.tolist()
        table[f"sagittal_{frequency:.4g}"] = sagittal.tolist()
    axes.set_ylim(0, 1.02)
    finish(axes, "image height (mm)", "MTF", None)
    below(figure, axes, len(data.asked_lp_per_mm))
    return figure, table


def curve_figure(
    panels: Sequence[tuple[str, Sequence[tuple[str, Array, str]]]], across: tuple[str, Array]
) -> tuple[Figure, list[Axes]]:
    """Draw panels side by side: (label of y, [(name, values, style)]) against one quantity."""
    figure, axes_row = panels_of(len(panels), 3.2)
    for axes, (label, lines) in zip(axes_row, panels, strict=True):
        for (name, values, style), look in zip(lines, LOOKS, strict=False):
            axes.plot(across[1], values, color=look.colour, ls=style, marker=look.marker, markevery=8, ms=4, label=name or None)
        axes.axhline(0.0, color="0.6", lw=0.7)
        finish(axes, across[0], label, handlelength=LEGEND_LINE)
    return figure, axes_row


@figure(
    "field_curvature",
    "Field curvature: foci of rays near the chief ray. Distortion: height of the chief ray against the tangent of the field "
    "angle times the scale of a very small image.",
)
def curvature_plate(data: LensData) -> Drawing:
    """Plot the tangential and sagittal foci and the distortion against the field angle."""
    c = data.curves
    percent = 100 * c["distortion"]
    lines = [("tangential", c["tangential_focus_mm"], "-"), ("sagittal", c["sagittal_focus_mm"], "--")]
    panels = [("focus behind the image plane (mm)", lines), ("distortion (%)", [("", percent, "-")])]
    figure, _ = curve_figure(panels, ("field angle (degrees)", data.curve_deg))
    foci = {name: c[name] for name in ("tangential_focus_mm", "sagittal_focus_mm")}
    table = {"field_deg": data.curve_deg, **foci, "distortion_percent": percent}
    return figure, table


@figure("illumination", "Relative illumination, and chief ray angle in image space.")
def illumination_plate(data: LensData) -> Drawing:
    """Plot the relative illumination and the chief ray angle against image height."""
    c = data.curves
    fourth = np.cos(np.radians(data.curve_deg)) ** 4
    light = [("traced", c["relative_illumination"], "-"), ("cos⁴ of the field angle", fourth, "--")]
    panels = [("relative illumination", light), ("chief ray angle (degrees)", [("", c["chief_ray_angle_deg"], "-")])]
    figure, row = curve_figure(panels, ("image height (mm)", c["image_height_mm"]))
    row[0].set_ylim(0, 1.05)
    traced = {name: c[name] for name in ("image_height_mm", "relative_illumination", "chief_ray_angle_deg")}
    table = {"field_deg": data.curve_deg, **traced, "cos4": fourth}
    return figure, table


@figure("colour", "Lateral colour of chief rays; axial colour: the paraxial focus of an object at infinity.")
def colour_plate(data: LensData) -> Drawing:
    """Plot the lateral colour against the field, and the paraxial focus against wavelength."""
    low, high = data.wavelength_nm.min(), data.wavelength_nm.max()
    nm, focus_um = data.axial_colour()
    figure, (left, right) = panels_of(2, 3.2)
    left.plot(data.curve_deg, data.curves["lateral_colour_um"], color=COLOURS[0], marker="o", markevery=8, ms=4)
    right.plot(nm, focus_um, color=COLOURS[0], marker="o", markevery=8, ms=4)
    finish(left, "field angle (degrees)", f"height at {high:.4g} minus {low:.4g} nm (µm)")
    finish(right, "wavelength (nm)", f"paraxial focus from that at {data.lens.primary_nm:.4g} nm (µm)")
    columns = {
        "field_deg": data.curve_deg,
        "lateral_colour_um": data.curves["lateral_colour_um"],
        "wavelength_nm": nm,
        "focus_um": focus_um,
    }
    return figure, columns


# The document ----------------------------------------------------------------------------------------------------------------

UNBROKEN = str.maketrans(" -", "\u00a0\u2011")  # a number and its name stay on one line of a page


def lens_document(data: LensData) -> Document:
    """Return the page of a lens: its layout, first-order data and fields, further figures, and its prescription."""
    lens, prescription = data.lens, data.lens.prescription
    over_field = (mtf_over_field, curvature_plate, illumination_plate) if data.field_deg.size > 1 else ()
    figures = spot_plate, psf_plate, mtf_plate, *over_field, colour_plate
    wavelengths = ", ".join(f"{nm:.5g}" for nm in data.wavelength_nm)
    limits = "rays times the limit of diffraction, since aberrations are large" if data.geometric else "waves"
    traced = f"Spots, PSFs and MTFs are of {wavelengths} nm with equal weights, all else of {lens.primary_nm:.5g} nm."
    computed = f"{traced} PSFs and MTFs are those of {limits}. The rms wavefront is without tilt."
    source = f"Source: {prescription.source or 'not stated'}. Radius of the stop: {lens.stop_semi_diameter_mm:.6g} mm."
    glasses = (
        *(f"glass {glass.name}: {glass.source}" for glass in prescription.glasses),
        f"uncoated surfaces would reflect {data.loss_percent:.3g} % of the light on the axis; camera.transmittance is what counts",
        *ghost_words(data),
    )
    return Document(
        command="lens",
        kind="lens",
        title=prescription.name,
        data=lens_values(data),
        answers=(Answer(title_of(data), (prescription.title,), named=True),),
        lead=(Plot(partial(layout, data)), *data.notes),
        sections=(
            Section("first-order", "First-order data", (first_order_table(data),), brief=True),
            Section("fields", "Fields", (field_table(data), computed), brief=True),
            Section("figures", "Figures", [Plot(partial(draw, data)) for draw in figures]),
            Section("glasses", "Glasses", (Listed(glasses),), folded=True, brief=True),
            Section("reflections", "Reflected twice", (ghost_table(data),) if data.ghosts else (), folded=True),
            Section("prescription", "Prescription", (surface_table(data), source, made_with()), folded=True),
        ),
    )


def lens_values(data: LensData) -> dict[str, Any]:
    """Return summary.json."""
    lens = data.lens
    first = [{"wavelength_nm": float(nm), **vars(order)} for nm, order in zip(data.wavelength_nm, data.first, strict=True)]
    content = {
        "name": lens.prescription.name,
        "title": lens.prescription.title,
        "source": lens.prescription.source,
        "primary_nm": lens.primary_nm,
        "max_field_deg": lens.max_field_deg,
        "object_distance_mm": lens.object_distance_mm if math.isfinite(lens.object_distance_mm) else None,
        "image_distance_mm": lens.prescription.surfaces[-1].thickness_mm,
        "stop_semi_diameter_mm": lens.stop_semi_diameter_mm,
        "working_f_number": lens.working_f_number,
        "fresnel_transmittance": lens.fresnel_transmittance(lens.primary_nm),
        "reflectance": data.reflectance,
        "reflected_twice": [plain(vars(ghost)) for ghost in data.ghosts],
        "pitch_um": data.pitch_um,
        "mtf_of": "rays times the limit of diffraction" if data.geometric else "waves",
        "first_order": [plain(order) for order in first],
        "glasses": [{"name": glass.name, "source": glass.source} for glass in lens.prescription.glasses],
        "fields": [
            plain(field) | {"mtf": [{"lp_per_mm": frequency} | plain(mtf) for frequency, mtf in mtfs.items()]}
            for field, mtfs in zip(field_values(data), field_mtfs(data), strict=True)
        ],
    }
    settings = {"lens": {"file": lens.prescription.name, "primary_nm": lens.primary_nm}, "pixel": {"pitch_um": data.pitch_um}}
    return result_data(content, settings=settings, notes=data.notes)


def field_values(data: LensData) -> list[dict[str, float]]:
    """Return what rays and waves of each field do, by names with units."""
    values = zip(data.field_deg.tolist(), data.height_mm.tolist(), data.spots, data.rms_waves.tolist(), strict=True)
    return [
        {"field_deg": angle, "height_mm": height, "rms_spot_um": spot.rms_um, "rms_wavefront_waves": rms}
        | {name: float(np.interp(angle, data.curve_deg, curve)) for name, curve in data.curves.items()}
        for angle, height, spot, rms in values
    ]


def field_mtfs(data: LensData) -> list[dict[float, dict[str, float]]]:
    """Return the tangential and sagittal MTF of each field by frequency in lp/mm."""
    mtfs = {frequency: data.mtf_at(frequency) for frequency in data.asked_lp_per_mm}
    return [
        {frequency: dict(zip(MTF_LINES, mtf[field].tolist(), strict=True)) for frequency, mtf in mtfs.items()}
        for field in range(data.field_deg.size)
    ]


def lens_csv(data: LensData) -> str:
    """Return a row for each field as CSV."""
    rows = [
        field | {f"mtf_{line}_{frequency:.4g}_lp_per_mm": mtf[line] for frequency, mtf in mtfs.items() for line in MTF_LINES}
        for field, mtfs in zip(field_values(data), field_mtfs(data), strict=True)
    ]
    return rows_csv(rows)


def title_of(data: LensData) -> str:
    """Return one line that says which lens this is."""
    lens, first = data.lens, data.primary
    place = "infinity" if math.isinf(lens.object_distance_mm) else f"{lens.object_distance_mm / 1e3:.4g} m"
    return (
        f"{one_line(lens.prescription.name)}: f = {first.focal_length_mm:.5g} mm, {f_stop(first.f_number)}, "
        f"fields to {lens.max_field_deg:.4g}°, image heights to {data.height_mm.max():.4g} mm, object at {place}"
    )


def first_order_table(data: LensData) -> DocumentTable:
    """Return the first-order data, with a column for each wavelength."""
    names = {
        "focal_length_mm": "focal length (mm)",
        "back_focal_length_mm": "back focal length (mm)",
        "entrance_pupil_diameter_mm": "entrance pupil, diameter (mm)",
        "entrance_pupil_from_first_vertex_mm": "entrance pupil, behind the first surface (mm)",
        "exit_pupil_diameter_mm": "exit pupil, diameter (mm)",
        "exit_pupil_from_image_mm": "exit pupil, behind the image plane (mm)",
        "f_number": "f-number",
    }
    head = ("", *(f"{nm:.5g} nm" for nm in data.wavelength_nm))
    rows = tuple((words, *(f"{getattr(each, name):.6g}" for each in data.first)) for name, words in names.items())
    return DocumentTable("first-order data", head, rows, "Paraxial, with the object at infinity")


def field_table(data: LensData) -> DocumentTable:
    """Return what rays and waves of each field do."""
    units = {"field": "°", "height": "mm", "chief ray": "°", "distortion": "%", "illumination": "", "spot": "µm rms",
             "wavefront": "waves rms"} | {f"MTF {f:.4g}/mm": "t / s" for f in data.asked_lp_per_mm}  # fmt: skip
    rows = [
        (
            f"{field['field_deg']:.4g}",
            f"{field['height_mm']:.4g}",
            f"{field['chief_ray_angle_deg']:.4g}",
            f"{100 * field['distortion']:.3g}",
            f"{field['relative_illumination']:.3f}",
            *(number(field[name], 3) for name in ("rms_spot_um", "rms_wavefront_waves")),
            *(UNKNOWN if dark else f"{mtf['tangential']:.2f} / {mtf['sagittal']:.2f}" for mtf in mtfs.values()),
        )
        for field, mtfs, dark in zip(field_values(data), field_mtfs(data), data.dark, strict=True)
    ]
    caption = "Real rays; MTF tangential / sagittal (t / s)"
    return DocumentTable("fields", tuple(f"{name}\n{unit}" for name, unit in units.items()), rows, caption)


SHARP = 0.1  # of the largest image height: light that is so close together is seen as a ghost, not as a veil
SHOWN_GHOSTS = 12


def ghost_words(data: LensData) -> list[str]:
    """Return how much light pairs of surfaces reflect twice, and which pair focuses it nearest to the sensor, as a sentence."""
    nearest = data.focused_ghost
    if nearest is None:
        return []
    coating = "bare glass" if data.reflectance is None else f"a coating that reflects {100 * data.reflectance:.3g} %"
    total, count = 100 * sum(ghost.share for ghost in data.ghosts), len(data.ghosts)
    image_mm = float(np.abs(data.height_mm).max())
    kind = "a ghost" if image_mm and nearest.blur_mm < SHARP * image_mm else "no ghost but a veil"
    pairs = f"{count} pair{'s' * (count > 1)} of surfaces reflect{'s' * (count == 1)}"
    front, back = nearest.surfaces
    return [
        f"{pairs} {total:.3g} % of it twice, with {coating}; nearest to the sensor focus {front} and {back}, to a disc of "
        f"{nearest.blur_mm:.3g} mm: {kind}"
    ]


def ghost_table(data: LensData) -> DocumentTable:
    """Return what the pairs of surfaces with the largest shares reflect twice, and the pair that focuses nearest to the sensor."""
    listed = data.ghosts[:SHOWN_GHOSTS]
    nearest = data.focused_ghost
    listed += [] if nearest is None or nearest in listed else [nearest]
    rows = tuple(
        (
            f"{each.surfaces[0]} and {each.surfaces[1]}", f"{100 * each.share:.3g}", number(each.focus_from_image_mm, 4),
            f"{each.blur_mm:.3g}",
        )
        for each in listed
    )  # fmt: skip
    head = "surfaces", "share of the light (%)", "focus behind the image plane (mm)", "disc of a point (mm)"
    shown = f", {SHOWN_GHOSTS} of {len(data.ghosts)} pairs" if len(data.ghosts) > len(listed) else ""
    caption = f"Light on the axis that two surfaces reflect{shown}: paraxial, not stopped by apertures"
    return DocumentTable("reflected-twice", head, rows, caption)


def surface_table(data: LensData) -> DocumentTable:
    """Return the prescription."""
    prescription = data.lens.prescription
    head = ("surface", "radius (mm)", "thickness (mm)", "medium behind", "conic", "asphere", "semi-diameter (mm)")
    rows = []
    for place, surface in enumerate(prescription.surfaces, 1):
        semi = "" if surface.semi_diameter_mm is None else f"{surface.semi_diameter_mm:.5g}"
        rows.append((
            f"{place}{', stop' if place == prescription.stop + 1 else ''}",
            "plane" if not surface.curvature_per_mm else f"{1 / surface.curvature_per_mm:.6g}",
            f"{surface.thickness_mm:.6g}",
            surface.glass.name,
            f"{surface.conic:.5g}" if surface.conic else "",
            ", ".join(f"A{power} {value:.4g}".translate(UNBROKEN) for power, value in surface.asphere),
            semi + (", clips" if surface.clips and semi else ""),
        ))  # fmt: skip
    caption = "Surfaces in the order of the light; the last thickness leads to the image plane"
    return DocumentTable("prescription", head, rows, caption)


PRESENTER = Presenter(document=lens_document, figure=layout, csv=lens_csv)
