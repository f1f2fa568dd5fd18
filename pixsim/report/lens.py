"""What a lens designer expects of a lens: numbers, figures with their tables, and one page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid, one_line
from pixsim.base.files import output_folder, publishing, versions, write_json
from pixsim.optics.diffraction import cutoff_cy_per_mm, diffraction_otf
from pixsim.optics.field_blur import UM_PER_NM, Light, even_window, fit_wavefronts, periodic_psf
from pixsim.optics.glass import AIR
from pixsim.optics.lens import FirstOrder, Lens
from pixsim.optics.lens_waves import pupil_rays
from pixsim.optics.ray_trace import sag_and_slope
from pixsim.show.figures import COLOURS, LEGEND_LINE, LOOKS, new_figure, own_style
from pixsim.show.pages import Column, Plate, coarse_table, plain, write_figures, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIELDS = 9  # from the axis to the largest, of spots, PSFs and MTFs
SHOWN = (0, 3, 6, 8)  # of these, in figures of single fields
CURVE_FIELDS = 33
NEAR_AXIS = 1e-3  # of the largest field: distortion on the axis is its limit, not 0 if the plane is out of focus
SPOT_RINGS = 6  # of rays: 1, 6, 12 … in each
FREQUENCIES = (10.0, 30.0, 60.0)  # lp/mm
MTF_POINTS = 61
MTF_LINES = ("tangential", "sagittal")
PSF_SPOTS = 6  # rms radii along a side of a PSF
PSF_SAMPLES = 3  # of the width λN along a side
MOST_SAMPLES = 160  # of a PSF along a side, where aberrations make it large
MOST_FINE = 3000  # samples along a side, on which waves interfere
MOST_WIDTHS = 300  # λN along a side; the PSF of waves would take seconds, and that of rays differs little
GRID, LINE_BINS = 81, 4096  # of rays across the stop, and of their line spread functions
RAYS_AIMED = 1e-4  # of the stop's radius, a hundredth of their distance
MOST_TRACED = 5e6  # rays of such a grid times surfaces, about a second: 81 across for three wavelengths and 28 surfaces
SHOWN_HALF_WIDTHS = 2.5  # rms radii of the largest spot, along half a side of the PSFs shown
DRAWN_FIELDS = (0.0, 0.7, 1.0)
DRAWN_HEIGHTS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # in the stop
DRAWN_EDGE = 1.05  # of the rays' heights, for a surface without a size
FIGURES = ("layout", "spots", "psf", "mtf", "mtf_over_field", "field_curvature", "illumination", "colour")
FILES = ("report.html", "summary.json", *(f"figures/{name}.{suffix}" for name in FIGURES for suffix in ("svg", "csv")))


@dataclass(frozen=True)
class Spot:
    """Rays of one field in the image plane.

    x_um, y_um : (wavelengths, rays) from the chief ray of the primary wavelength; NaN for rays that do not get through
    """

    x_um: Array
    y_um: Array

    @property
    def rms_um(self) -> float:
        """Root mean square distance from the centroid of all rays."""
        x, y = (part[np.isfinite(part)] for part in (self.x_um, self.y_um))
        return float(np.sqrt(x.var() + y.var())) if x.size else math.nan


@dataclass(frozen=True)
class LensData:
    """All numbers of a lens's page.

    wavelength_nm : of equal weight
    first : first-order data of each wavelength
    field_deg : (F,) of spots, PSFs and MTFs
    spots : one of each field
    psfs : (n, n) of each field, means over squares of `psf_pitch_um`; the chief ray of the primary wavelength in the middle
    dark : (F,), whether no light reaches the image of a field: its spot and MTF are NaN, its PSF 0
    geometric : whether aberrations are so large that PSFs and MTFs are those of rays, times the limit of diffraction
    frequency_lp_per_mm : (n,)
    mtf : (F, 2, n), tangential and sagittal
    rms_waves : (F,), rms wavefront of the primary wavelength without piston and tilt
    curve_deg : (n,) of the curves over the field
    curves : name -> values (n,)
    pitch_um : of the pixel whose Nyquist frequency is looked at
    notes : of how the file was read
    """

    lens: Lens
    wavelength_nm: Array
    first: Sequence[FirstOrder]
    field_deg: Array
    spots: Sequence[Spot]
    psfs: Sequence[Array]
    psf_pitch_um: float
    dark: NDArray[np.bool_]
    geometric: bool
    frequency_lp_per_mm: Array
    mtf: Array
    rms_waves: Array
    curve_deg: Array
    curves: dict[str, Array]
    pitch_um: float | None
    notes: Sequence[str] = ()

    @property
    def primary(self) -> FirstOrder:
        return self.lens.first_order(self.lens.primary_nm)

    @property
    def asked_lp_per_mm(self) -> tuple[float, ...]:
        """Frequencies of the tables: 10, 30 and 60 lp/mm, and the pixel's Nyquist frequency."""
        return asked_frequencies(self.pitch_um)

    def mtf_at(self, frequency_lp_per_mm: float) -> Array:
        """Return the tangential and sagittal MTF at one frequency of the tables, (F, 2)."""
        index = int(np.argmin(np.abs(self.frequency_lp_per_mm - frequency_lp_per_mm)))
        return np.asarray(self.mtf[:, :, index])

    @property
    def height_mm(self) -> Array:
        """Image heights of the fields, (F,)."""
        return np.asarray(self.lens.chief_ray(self.field_deg, self.lens.primary_nm).height_mm)

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON."""
        lens = self.lens
        fields = [
            {
                "field_deg": float(angle),
                "height_mm": float(height),
                "rms_spot_um": spot.rms_um,
                "rms_wavefront_waves": float(rms),
                **{name: float(np.interp(angle, self.curve_deg, values)) for name, values in self.curves.items()},
                "mtf": [
                    {"lp_per_mm": f, **plain({name: float(self.mtf_at(f)[i, axis]) for axis, name in enumerate(MTF_LINES)})}
                    for f in self.asked_lp_per_mm
                ],
            }
            for i, (angle, height, spot, rms) in enumerate(
                zip(self.field_deg, self.height_mm, self.spots, self.rms_waves, strict=True)
            )
        ]
        first = [{"wavelength_nm": float(nm), **vars(each)} for nm, each in zip(self.wavelength_nm, self.first, strict=True)]
        return {
            "name": lens.prescription.name,
            "title": lens.prescription.title,
            "source": lens.prescription.source,
            "primary_nm": lens.primary_nm,
            "max_field_deg": lens.max_field_deg,
            "object_distance_mm": lens.object_distance_mm if math.isfinite(lens.object_distance_mm) else None,
            "image_distance_mm": lens.prescription.surfaces[-1].thickness_mm,
            "stop_semi_diameter_mm": lens.stop_semi_diameter_mm,
            "fresnel_transmittance": lens.fresnel_transmittance(lens.primary_nm),
            "pitch_um": self.pitch_um,
            "mtf_of": "rays times the limit of diffraction" if self.geometric else "waves",
            "first_order": [plain(each) for each in first],
            "glasses": [{"name": glass.name, "source": glass.source} for glass in lens.prescription.glasses],
            "fields": [plain(each) for each in fields],
            "notes": list(self.notes),
        }


def asked_frequencies(pitch_um: float | None) -> tuple[float, ...]:
    """Return the frequencies of the tables in lp/mm."""
    return FREQUENCIES if pitch_um is None else tuple(sorted({*FREQUENCIES, 500 / pitch_um}))


def lens_data(
    lens: Lens, wavelength_nm: Sequence[float] | None = None, pitch_um: float | None = None, notes: Sequence[str] = ()
) -> LensData:
    """Trace a lens.

    wavelength_nm : of equal weight; those of its file by default
    pitch_um : of a pixel whose Nyquist frequency is looked at
    notes : of how the file was read

    Raises PixsimError if a wavelength is outside the range of a glass, or if chief rays do not reach the image.
    """
    wavelengths = np.array(wavelength_nm or lens.prescription.wavelengths_nm)
    primary = lens.primary_nm
    largest = lens.max_field_deg
    fields = np.linspace(0.0, largest, FIELDS) if largest else np.zeros(1)
    curve = np.linspace(0.0, largest, CURVE_FIELDS) if largest else np.zeros(1)
    x, y = spot_points()
    illumination = lens.projected_solid_angle_sr(curve, primary)
    dark = np.asarray(illumination[:: (CURVE_FIELDS - 1) // (FIELDS - 1)] <= 0)
    if dark[0]:
        got = "no light on the axis"
        raise invalid(f"lens '{lens.prescription.name}'", got, "light on the axis", "Check its clear apertures and semi-diameters.")
    spots = []
    for angle, none in zip(fields, dark, strict=True):
        waves = lens.wavefront(angle, wavelengths, x, y)
        seen = waves.passed & np.isfinite(waves.opd_waves) & ~none
        off = waves.chief_y_mm[:, None] - lens.chief_ray(angle, primary).height_mm
        spots.append(Spot(*(np.where(seen, 1e3 * part, np.nan) for part in (waves.x_mm, waves.y_mm + off))))
    asked = asked_frequencies(pitch_um)
    shortest, f_number = float(wavelengths.min()), lens.first_order(primary).f_number
    cutoff = float(cutoff_cy_per_mm(shortest, f_number))
    highest = max(1.1 * max(asked), min(cutoff, 1.5 * max(asked), 150.0))
    frequency = np.unique(np.concatenate([np.linspace(0.0, highest, MTF_POINTS), asked]))
    dark = dark | np.array([math.isnan(spot.rms_um) for spot in spots])  # or too little light for a ray
    side = PSF_SPOTS * max(spot.rms_um for spot, none in zip(spots, dark, strict=True) if not none)
    geometric = side > MOST_WIDTHS * 1e-3 * shortest * f_number
    pitch = min(max(1e-3 * shortest * f_number / PSF_SAMPLES, side / MOST_SAMPLES), 500 / min(highest, 1.05 * cutoff))
    seen_fields = fields[~dark]
    if not geometric:
        psfs = point_spreads(lens, seen_fields, wavelengths, pitch, side)
        geometric = not psfs
    if geometric:
        pitch = side / MOST_SAMPLES
        psfs, mtf = ray_spreads(lens, seen_fields, wavelengths, pitch, frequency)
    else:
        mtf = np.array([[line_mtf(psf.sum(axis=1 - axis), pitch, frequency) for axis in (0, 1)] for psf in psfs])
    for index in np.flatnonzero(dark):  # in rising order, so that each is put at its place
        psfs.insert(int(index), np.zeros_like(psfs[0]))
        mtf = np.insert(mtf, index, np.nan, axis=0)
    mtf[..., frequency > cutoff] = 0.0  # where samples of the PSF would repeat lower frequencies
    chief = lens.chief_ray(curve, primary)
    tangential, sagittal = lens.foci_mm(curve, primary)
    ends = lens.chief_ray(curve[:, None], np.array([wavelengths.min(), wavelengths.max()])).height_mm
    curves = {
        "image_height_mm": chief.height_mm,
        "chief_ray_angle_deg": chief.angle_deg,
        "distortion": lens.distortion(np.maximum(curve, NEAR_AXIS * largest)) if largest else np.zeros(1),
        "relative_illumination": illumination / illumination[0],
        "tangential_focus_mm": tangential,
        "sagittal_focus_mm": sagittal,
        "lateral_colour_um": 1e3 * (ends[:, 1] - ends[:, 0]),
    }
    first = [lens.first_order(float(nm)) for nm in wavelengths]
    return LensData(
        lens, wavelengths, first, fields, spots, psfs, pitch, dark, geometric, frequency, mtf,
        np.where(dark, np.nan, rms_wavefronts(lens, fields)), curve,
        {name: np.asarray(values) for name, values in curves.items()}, pitch_um, notes,
    )  # fmt: skip


def spot_points() -> tuple[Array, Array]:
    """Return points of the stop of about equal areas, (rays,) each."""
    radius = np.concatenate([[0.0], *(np.full(6 * ring, ring / SPOT_RINGS) for ring in range(1, SPOT_RINGS + 1))])
    radius *= SPOT_RINGS / (SPOT_RINGS + 0.5)  # a ring is the middle of its area
    angle = np.concatenate([[0.0], *((np.arange(6 * ring) + 0.5) / (3 * ring) * np.pi for ring in range(1, SPOT_RINGS + 1))])
    return radius * np.cos(angle), radius * np.sin(angle)


def rms_wavefronts(lens: Lens, field_deg: Array) -> Array:
    """Return the rms wavefront at the primary wavelength without piston and tilt, (F,), in waves."""
    x, y = spot_points()
    waves = lens.wavefront(field_deg, lens.primary_nm, x, y)
    found = []
    for opd, passed, cosines in zip(waves.opd_waves, waves.passed, waves.cosines, strict=True):
        seen = passed & np.isfinite(opd)
        basis = np.column_stack([np.ones(int(seen.sum())), cosines[seen]])
        residual = (
            opd[seen] - basis @ np.linalg.lstsq(basis, opd[seen], rcond=None)[0] if seen.sum() > basis.shape[1] else [math.nan]
        )
        found.append(float(np.std(residual)))
    return np.array(found)


def point_spreads(lens: Lens, field_deg: Array, wavelength_nm: Array, pitch_um: float, side_um: float) -> list[Array]:
    """Return the PSF of each field, means over squares of `pitch_um`, with the chief ray in the middle of y upwards, (n, n).

    None at all if the cone of light at the image plane has much finer waves than the f-number tells, as far from a focus.

    side_um : at least, of the square that a PSF lies in
    """
    heights = 1e3 * np.asarray(lens.chief_ray(field_deg, lens.primary_nm).height_mm)
    rays = pupil_rays(lens, field_deg, wavelength_nm)
    fronts = [fit_wavefronts(float(nm), heights, of_nm) for nm, of_nm in zip(wavelength_nm, rays, strict=True)]
    light = Light(fronts, np.full(len(fronts), 1 / len(fronts)))
    found = []
    for height in heights:
        window = even_window(light, 0.0, float(height), pitch_um, math.ceil(side_um / pitch_um))
        widest_per_nm = max(2 * float(front.at(float(height))[:2].max()) / front.wavelength_nm for front in fronts)
        if 2 * window * pitch_um / UM_PER_NM * widest_per_nm > MOST_FINE:
            return []
        found.append(np.fft.fftshift(periodic_psf(light, 0.0, float(height), pitch_um, window)))
    return found


def ray_spreads(
    lens: Lens, field_deg: Array, wavelength_nm: Array, pitch_um: float, frequency_lp_per_mm: Array
) -> tuple[list[Array], Array]:
    """Return PSFs of rays, as `point_spreads` does, and MTFs (F, 2, n): those of the rays times the limit of diffraction."""
    rays = GRID**2 * field_deg.size * wavelength_nm.size * len(lens.prescription.surfaces)
    grid = np.linspace(-1, 1, round(GRID * min(1.0, math.sqrt(MOST_TRACED / rays))))
    x, y = (part[np.hypot(*np.meshgrid(grid, grid)) <= 1] for part in np.meshgrid(grid, grid))
    f_number = lens.first_order(lens.primary_nm).f_number
    limit = np.mean([diffraction_otf(frequency_lp_per_mm, float(nm), f_number) for nm in wavelength_nm], axis=0)
    edges = (np.arange(MOST_SAMPLES + 2) - (MOST_SAMPLES + 1) / 2) * pitch_um
    psfs, mtf = [], []
    for angle in field_deg:
        waves = lens.wavefront(angle, wavelength_nm, x, y, RAYS_AIMED)
        seen = waves.passed & np.isfinite(waves.opd_waves)
        off = waves.chief_y_mm[:, None] - lens.chief_ray(angle, lens.primary_nm).height_mm
        across, along = 1e3 * waves.x_mm[seen], 1e3 * (waves.y_mm + off)[seen]
        counts = np.histogram2d(along, across, [edges, edges])[0]
        psfs.append(counts / max(along.size, 1))
        lines = []
        for values in (along, across):
            reach = max(float(np.abs(values).max(initial=0.0)), pitch_um) * (1 + 1e-9)
            line, _ = np.histogram(values, LINE_BINS, (-reach, reach))
            lines.append(line_mtf(line.astype(float), 2 * reach / LINE_BINS, frequency_lp_per_mm) * limit)
        mtf.append(lines)
    return psfs, np.array(mtf)


def line_mtf(line: Array, pitch_um: float, frequency_lp_per_mm: Array) -> Array:
    """Return the MTF (n,) of a line spread function: the modulus of its Fourier transform, 1 at frequency 0."""
    at_mm = (np.arange(line.size) - line.size // 2) * pitch_um * 1e-3
    turning = np.exp(-2j * np.pi * frequency_lp_per_mm[:, None] * at_mm)
    return np.asarray(np.abs(turning @ line) / line.sum())


# Figures ---------------------------------------------------------------------------------------------------------------------


def lens_plates(data: LensData) -> list[Plate]:
    """Return the figures of a lens, in the order of the page; without those over the field if there is one field only."""
    over_field = (mtf_over_field, curvature_plate, illumination_plate) if data.field_deg.size > 1 else ()
    return [make(data) for make in (layout, spot_plate, psf_plate, mtf_plate, *over_field, colour_plate)]


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


def finish(axes: Axes, x: str, y: str, legend: Literal["best"] | None = "best") -> None:
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8, loc=legend, handlelength=LEGEND_LINE)


def below(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend below the axes."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="lower center", ncols=columns, frameon=False, fontsize=8, handlelength=LEGEND_LINE
    )


@own_style()
def layout(data: LensData) -> Plate:
    """Draw the surfaces and rays of three fields in the y-z plane."""
    lens, surfaces = data.lens, data.lens.prescription.surfaces
    vertices = np.cumsum([0.0, *(surface.thickness_mm for surface in surfaces)])
    fields = [share * lens.max_field_deg for share in (DRAWN_FIELDS if lens.max_field_deg else DRAWN_FIELDS[:1])]
    paths = [lens.ray_points(angle, lens.primary_nm, 0 * np.array(DRAWN_HEIGHTS), DRAWN_HEIGHTS) for angle in fields]
    reached = np.nanmax(np.abs([path[:, :-1, 1] for path in paths]), axis=(0, 1))
    edges = [surface.semi_diameter_mm or DRAWN_EDGE * float(most) for surface, most in zip(surfaces, reached, strict=True)]
    figure, (axes,) = panels_of(1, 4.1, legend_below=True)
    outlines = []
    for surface, vertex, edge in zip(surfaces, vertices, edges, strict=False):
        y = np.linspace(-edge, edge, 81)
        with np.errstate(invalid="ignore"):
            sag, _ = sag_and_slope(surface, np.square(y))
        outlines.append((vertex + sag, y))
    for index, (surface, (z, y)) in enumerate(zip(surfaces, outlines, strict=True)):
        is_glass = surface.glass != AIR
        after_glass = index > 0 and surfaces[index - 1].glass != AIR
        if is_glass and index + 1 < len(surfaces):
            far_z, far_y = outlines[index + 1]
            axes.fill(np.concatenate([z, far_z[::-1]]), np.concatenate([y, far_y[::-1]]), color="#dfe9f2", lw=0)
            for end in (0, -1):
                axes.plot([z[end], far_z[end]], [y[end], far_y[end]], color="0.35", lw=0.8)
        if is_glass or after_glass:
            axes.plot(z, y, color="0.35", lw=0.9)
    stop, semi = lens.prescription.stop, lens.stop_semi_diameter_mm
    at = vertices[stop] + float(sag_and_slope(surfaces[stop], np.array(semi**2))[0])
    for sign in (1, -1):
        axes.plot([at, at], [sign * semi, sign * 1.35 * semi], color="black", lw=2.5, label="stop" if sign > 0 else None)
    table: dict[str, list[float | str]] = {"field_deg": [], "stop_y": [], "z_mm": [], "y_mm": []}
    length = vertices[-1]
    for angle, path, look in zip(fields, paths, LOOKS, strict=False):
        passed = lens.wavefront(angle, lens.primary_nm, np.zeros(len(DRAWN_HEIGHTS)), DRAWN_HEIGHTS).passed[0]
        for number, (height, points) in enumerate(zip(np.array(DRAWN_HEIGHTS)[passed], path[passed], strict=True)):
            slope = math.tan(math.radians(angle)) if math.isinf(lens.object_distance_mm) else None
            z, y = points[:, 2], points[:, 1]
            if slope is not None:  # a piece of the parallel light in front
                z, y = np.concatenate([[z[0] - 0.15 * length], z]), np.concatenate([[y[0] - 0.15 * length * slope], y])
            axes.plot(z, y, color=look.colour, lw=0.8, ls=look.dashes, label=None if number else f"{angle:.3g}°")
            table["field_deg"] += [angle] * z.size
            table["stop_y"] += [float(height)] * z.size
            table["z_mm"] += z.tolist()
            table["y_mm"] += y.tolist()
    image = max(float(np.abs(data.curves["image_height_mm"]).max()), semi)
    axes.plot([vertices[-1]] * 2, [-1.05 * image, 1.05 * image], color="black", lw=1.2)
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, "z (mm from the first surface)", "y (mm)", None)
    below(figure, axes, len(fields) + 1)
    caption = (
        f"The lens is {length:.4g} mm long, from its first surface to the image plane, and takes in fields to "
        f"{lens.max_field_deg:.3g}°. "
        f"Layout with rays at {lens.primary_nm:.5g} nm, for each field through the centre of the stop, its edges and halfway "
        "between, but for those that a clear aperture stops. Light travels to the right, to the image plane."
    )
    return Plate("layout", caption, figure, dict(table))


def shown_fields(data: LensData) -> list[int]:
    return [index for index in SHOWN if index < data.field_deg.size]


def ends_words(what: str, field_deg: Sequence[float], values: Sequence[float], unit: str) -> str:
    """Return where a number is smallest and largest, as a sentence."""
    known = [(value, angle) for value, angle in zip(values, field_deg, strict=True) if math.isfinite(value)]
    if not known:
        return f"{what} is not known: no ray reaches the image plane."
    (low, near), (high, far) = min(known), max(known)
    least, most = (f"{float(f'{value:.3g}'):g} {unit}" for value in (low, high))
    if near == far:
        return f"{what} is {least} at {near:.3g}°."
    return f"{what} is smallest at {near:.3g}° ({least}) and largest at {far:.3g}° ({most})."


def half_words(data: LensData) -> str:
    """Return where the lower MTF, tangential or sagittal, falls to one half on the axis and in the worst field, as a sentence."""
    ends, lit_deg = [], data.field_deg[~data.dark]
    for mtf in data.mtf[~data.dark].min(axis=1):
        below = np.flatnonzero(mtf < 0.5)
        ends.append(float(data.frequency_lp_per_mm[below[0]]) if below.size else math.inf)
    if math.isinf(min(ends)):
        return "The MTF is above one half in this figure, in every field."
    words = [f"at {end:.3g} lp/mm" if math.isfinite(end) else "beyond this figure" for end in ends]
    worst = int(np.argmin(ends))
    if not worst:
        return f"The lower MTF falls to one half {words[0]} on the axis, and nowhere earlier."
    return f"The lower MTF falls to one half {words[0]} on the axis, and earliest {words[worst]} at {lit_deg[worst]:.3g}°."


@own_style()
def spot_plate(data: LensData) -> Plate:
    """Draw the spots of some fields on one scale, with the diameter of the Airy disc."""
    shown = shown_fields(data)
    figure, panels = panels_of(len(shown), 2.9, shared=True, legend_below=True)
    airy = 1.22e-3 * data.lens.primary_nm * data.primary.f_number
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
        turn = np.linspace(0, 2 * np.pi, 73)
        axes.plot(airy * np.cos(turn), airy * np.sin(turn), color="black", lw=0.9, label="Airy disc")
        rms = "no light" if data.dark[index] else f"rms {spot.rms_um:.3g} µm"
        axes.set_title(f"{angle:.3g}°: {rms}", fontsize=9)
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)
        axes.set_xlabel("x (µm)")
    panels[0].set(ylabel="y (µm)", xlim=(-1.1 * most, 1.1 * most), ylim=(-1.1 * most, 1.1 * most))
    below(figure, panels[0], 6)
    caption = (
        f"{ends_words('The spot', data.field_deg.tolist(), [spot.rms_um for spot in data.spots], 'µm rms')} "
        f"Spots: where rays of each wavelength meet the image plane, from the chief ray at {data.lens.primary_nm:.5g} nm; y points "
        "away from the axis. The circle is the first dark ring of diffraction. Rays that clear apertures stop are left out."
    )
    return Plate("spots", caption, figure, dict(table))


def how(data: LensData) -> str:
    """Return how PSFs and MTFs were computed, for captions."""
    return "of rays and the limit of diffraction, since aberrations are large" if data.geometric else "with diffraction"


@own_style()
def psf_plate(data: LensData) -> Plate:
    """Show the point spread functions of some fields on one scale."""
    shown = shown_fields(data)
    largest = max(data.spots[index].rms_um for index in shown if not data.dark[index])
    half = max(SHOWN_HALF_WIDTHS * largest, 4e-3 * data.lens.primary_nm * data.primary.f_number)
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
    areas = [float((psf >= psf.max() / 2).sum()) * data.psf_pitch_um**2 if psf.any() else math.nan for psf in data.psfs]
    caption = (
        f"{ends_words('The area above half of the maximum', data.field_deg.tolist(), areas, 'µm²')} "
        f"Point spread functions of the {len(data.wavelength_nm)} wavelengths together, {how(data)}; brightness is the square "
        "root of the irradiance over its maximum. y points away from the axis. The table has means over blocks."
    )
    return Plate("psf", caption, figure, table)


@own_style()
def mtf_plate(data: LensData) -> Plate:
    """Plot the MTF of some fields against frequency, and the limit of diffraction."""
    figure, (axes,) = panels_of(1, 4.4, legend_below=True)
    figure.subplots_adjust(bottom=0.9 / 4.4 + 0.04)
    frequency = data.frequency_lp_per_mm
    table: dict[str, Column] = {"frequency_lp_per_mm": frequency.tolist()}
    for index, look in zip(shown_fields(data), LOOKS, strict=False):
        angle = data.field_deg[index]
        for kind, mtf, dashes in zip(("tangential", "sagittal"), data.mtf[index], ("-", (0, (4, 2))), strict=True):
            axes.plot(
                frequency, mtf, color=look.colour, ls=dashes, marker=look.marker, markevery=10, ms=4, lw=1.2,
                label=f"{angle:.3g}° {kind}",
            )  # fmt: skip
            table[f"{kind}_{angle:.4g}_deg"] = mtf.tolist()
    limit = np.mean([diffraction_otf(frequency, float(nm), data.primary.f_number) for nm in data.wavelength_nm], axis=0)
    axes.plot(frequency, limit, color="0.5", lw=1, ls=":", label="diffraction, on the axis")
    table["diffraction"] = limit.tolist()
    if data.pitch_um is not None:
        axes.axvline(500 / data.pitch_um, color="0.5", lw=0.8, ls=(0, (6, 2, 1, 2)), label=f"Nyquist of {data.pitch_um:g} µm")
    axes.set(xlim=(0, frequency[-1]), ylim=(0, 1.02))
    finish(axes, "frequency (line pairs/mm)", "MTF", None)
    below(figure, axes, 5)
    caption = half_words(data)
    caption += f" MTF of the wavelengths together, {how(data)}: tangential (lines across the radius) and sagittal (lines along it)."
    return Plate("mtf", caption, figure, table)


@own_style()
def mtf_over_field(data: LensData) -> Plate:
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
    finest = data.asked_lp_per_mm[-1]
    lowest = data.mtf_at(finest).min(axis=1)
    at = int(np.nanargmin(lowest))
    caption = (
        f"At {finest:.4g} lp/mm, the MTF is least at an image height of {height[at]:.3g} mm: {lowest[at]:.2f}. MTF against image "
        "height. Solid: tangential; dashed: sagittal."
    )
    return Plate("mtf_over_field", caption, figure, table)


@own_style()
def curve_figure(
    data: LensData, panels: Sequence[tuple[str, Sequence[tuple[str, Array, str]]]], across: tuple[str, Array]
) -> tuple[Figure, list[Axes]]:
    """Draw panels side by side: (label of y, [(name, values, style)]) against one quantity."""
    figure, axes_row = panels_of(len(panels), 3.2)
    for axes, (label, lines) in zip(axes_row, panels, strict=True):
        for (name, values, style), look in zip(lines, LOOKS, strict=False):
            axes.plot(across[1], values, color=look.colour, ls=style, marker=look.marker, markevery=8, ms=4, label=name or None)
        axes.axhline(0.0, color="0.6", lw=0.7)
        finish(axes, across[0], label)
    return figure, axes_row


def curvature_plate(data: LensData) -> Plate:
    """Plot the tangential and sagittal foci and the distortion against the field angle."""
    c = data.curves
    percent = 100 * c["distortion"]
    lines = [("tangential", c["tangential_focus_mm"], "-"), ("sagittal", c["sagittal_focus_mm"], "--")]
    panels = [("focus behind the image plane (mm)", lines), ("distortion (%)", [("", percent, "-")])]
    figure, _ = curve_figure(data, panels, ("field angle (degrees)", data.curve_deg))
    foci_mm = np.concatenate([c["tangential_focus_mm"], c["sagittal_focus_mm"]])
    caption = (
        f"Distortion goes from {percent.min():.2f} to {percent.max():.2f} %, and the foci lie from {foci_mm.min():.3f} to "
        f"{foci_mm.max():.3f} mm behind the image plane. Field curvature and distortion at {data.lens.primary_nm:.5g} nm. Left: "
        "foci of rays near the chief ray. Right: height "
        "of the chief ray against focal length times tangent, so that an image plane off the paraxial focus is a part of it."
    )
    foci = {name: c[name] for name in ("tangential_focus_mm", "sagittal_focus_mm")}
    table = {"field_deg": data.curve_deg, **foci, "distortion_percent": percent}
    return Plate("field_curvature", caption, figure, {name: values.tolist() for name, values in table.items()})


def illumination_plate(data: LensData) -> Plate:
    """Plot the relative illumination and the chief ray angle against image height."""
    c = data.curves
    fourth = np.cos(np.radians(data.curve_deg)) ** 4
    light = [("traced", c["relative_illumination"], "-"), ("cos⁴ of the field angle", fourth, "--")]
    panels = [("relative illumination", light), ("chief ray angle (degrees)", [("", c["chief_ray_angle_deg"], "-")])]
    figure, row = curve_figure(data, panels, ("image height (mm)", c["image_height_mm"]))
    row[0].set_ylim(0, 1.05)
    corner, angle = 100 * c["relative_illumination"][-1], c["chief_ray_angle_deg"][-1]
    caption = (
        f"At an image height of {c['image_height_mm'][-1]:.3g} mm, the light is {corner:.0f} % of that on the axis and arrives at "
        f"{angle:.3g}°. Relative illumination and chief ray angle in image space at {data.lens.primary_nm:.5g} nm. The "
        "illumination is the "
        "area of the directions at the image point whose rays pass the stop and the clear apertures."
    )
    traced = {name: c[name] for name in ("image_height_mm", "relative_illumination", "chief_ray_angle_deg")}
    table = {"field_deg": data.curve_deg, **traced, "cos4": fourth}
    return Plate("illumination", caption, figure, {name: values.tolist() for name, values in table.items()})


@own_style()
def colour_plate(data: LensData) -> Plate:
    """Plot the lateral colour against the field, and the paraxial focus against wavelength."""
    low, high = data.wavelength_nm.min(), data.wavelength_nm.max()
    nm = np.linspace(low, high, CURVE_FIELDS) if high > low else np.array([low])
    focus = np.array([data.lens.first_order(float(each)).back_focal_length_mm for each in nm])
    focus_um = 1e3 * (focus - data.primary.back_focal_length_mm)
    figure, (left, right) = panels_of(2, 3.2)
    left.plot(data.curve_deg, data.curves["lateral_colour_um"], color=COLOURS[0], marker="o", markevery=8, ms=4)
    right.plot(nm, focus_um, color=COLOURS[0], marker="o", markevery=8, ms=4)
    finish(left, "field angle (degrees)", f"height at {high:.4g} minus {low:.4g} nm (µm)")
    finish(right, "wavelength (nm)", f"paraxial focus from that at {data.lens.primary_nm:.4g} nm (µm)")
    lateral_um = float(np.abs(data.curves["lateral_colour_um"]).max())
    caption = (
        f"From {low:.4g} to {high:.4g} nm, lateral colour reaches {lateral_um:.2g} µm, and the focus on the axis moves by "
        f"{np.ptp(focus_um):.3g} µm. Lateral colour of chief rays, and axial colour: the paraxial focus of an object at infinity."
    )
    longest = max(nm.size, data.curve_deg.size)
    columns = {"field_deg": data.curve_deg, "lateral_colour_um": data.curves["lateral_colour_um"], "wavelength_nm": nm,
               "focus_um": focus_um}  # fmt: skip
    table = {name: values.tolist() + [math.nan] * (longest - values.size) for name, values in columns.items()}
    return Plate("colour", caption, figure, table)


# Text and page ---------------------------------------------------------------------------------------------------------------

Rows = list[tuple[str, ...]]
UNBROKEN = str.maketrans(" -", "\u00a0\u2011")  # a number and its name stay on one line of a page


def first_order_rows(data: LensData) -> Rows:
    """Return the table of first-order data: a column for each wavelength."""
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
    return [head, *((words, *(f"{getattr(each, name):.6g}" for each in data.first)) for name, words in names.items())]


def surface_rows(data: LensData) -> Rows:
    """Return the prescription as a table."""
    rows: Rows = [("", "radius (mm)", "thickness (mm)", "medium behind", "conic", "asphere", "semi-diameter (mm)")]
    for number, surface in enumerate(data.lens.prescription.surfaces, 1):
        semi = "" if surface.semi_diameter_mm is None else f"{surface.semi_diameter_mm:.5g}"
        rows.append((
            f"{number}{', stop' if number == data.lens.prescription.stop + 1 else ''}",
            "plane" if not surface.curvature_per_mm else f"{1 / surface.curvature_per_mm:.6g}",
            f"{surface.thickness_mm:.6g}",
            surface.glass.name,
            f"{surface.conic:.5g}" if surface.conic else "",
            ", ".join(f"A{power} {value:.4g}".translate(UNBROKEN) for power, value in surface.asphere),
            semi + (", clips" if surface.clips and semi else ""),
        ))  # fmt: skip
    return rows


def field_rows(data: LensData) -> Rows:
    """Return the table of the fields."""
    rows: Rows = [
        ("field (°)", "height (mm)", "chief ray (°)", "distortion (%)", "illumination", "rms spot (µm)", "rms wavefront (waves)",
         *(f"MTF at {f:.4g}/mm" for f in data.asked_lp_per_mm))
    ]  # fmt: skip
    for each, dark in zip(data.as_dict()["fields"], data.dark, strict=True):
        rows.append((
            f"{each['field_deg']:.4g}", f"{each['height_mm']:.4g}", f"{each['chief_ray_angle_deg']:.4g}",
            f"{100 * each['distortion']:.3g}", f"{each['relative_illumination']:.3f}",
            "–" if each["rms_spot_um"] is None else f"{each['rms_spot_um']:.3g}",
            "–" if each["rms_wavefront_waves"] is None else f"{each['rms_wavefront_waves']:.3g}",
            *("–" if dark else f"{mtf['tangential']:.2f} / {mtf['sagittal']:.2f}" for mtf in each["mtf"]),
        ))  # fmt: skip
    return rows


def title_of(data: LensData) -> str:
    """Return one line that says which lens this is."""
    lens, first = data.lens, data.primary
    place = "infinity" if math.isinf(lens.object_distance_mm) else f"{lens.object_distance_mm / 1e3:.4g} m"
    return (
        f"{one_line(lens.prescription.name)}: f = {first.focal_length_mm:.5g} mm, f/{first.f_number:.4g}, "
        f"fields to {lens.max_field_deg:.4g}°, image heights to {data.height_mm.max():.4g} mm, object at {place}"
    )


def lens_lines(data: LensData) -> list[str]:
    """Return the lines for the terminal."""
    lines = [title_of(data), f"  {data.lens.prescription.title}", ""]
    _, *numbers = field_rows(data)
    mtf = [f"MTF {f:.4g}/mm" for f in data.asked_lp_per_mm]
    short: Rows = [
        ("field", "height", "chief ray", "distortion", "illumination", "spot", "wavefront", *mtf),
        ("°", "mm", "°", "%", "", "µm rms", "waves rms", *("t / s" for _ in mtf)),
    ]
    for rows in (first_order_rows(data), [*short, *numbers]):
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
            lines.append("  " + "  ".join(cells).rstrip())
        lines.append("")
    lines += [f"  glass {glass.name}: {glass.source}" for glass in data.lens.prescription.glasses]
    loss = 100 * (1 - data.lens.fresnel_transmittance(data.lens.primary_nm))
    lines.append(f"  uncoated surfaces would reflect {loss:.3g} % of the light on the axis; camera.transmittance is what counts")
    return lines


def write_lens(data: LensData, out: Path) -> Path:
    """Write the page of a lens, its figures and summary.json into a folder and return the path of the page.

    Raises PixsimError if the folder cannot be written, or holds a file of such a name that pixsim did not write.
    """
    with output_folder(out), publishing(out, "lens") as folder:
        shown = write_figures(folder, [plate.drawn() for plate in lens_plates(data)])
        write_json(folder / "summary.json", data.as_dict())
        page = {
            "title": title_of(data), "lens": data.lens, "plates": shown, "first_order": first_order_rows(data),
            "surfaces": surface_rows(data), "fields": field_rows(data), "glasses": data.lens.prescription.glasses,
            "loss": 100 * (1 - data.lens.fresnel_transmittance(data.lens.primary_nm)), "versions": versions(),
            "notes": data.notes, "wavelengths": ", ".join(f"{nm:.5g}" for nm in data.wavelength_nm),
        }  # fmt: skip
        write_page(folder / "report.html", "lens.html.j2", page)
    return out / "report.html"


def chosen_lens(
    lens: Lens,
    focal_length_mm: float | None,
    f_number: float | None,
    field_deg: float | None,
    refocus: str | None,
    object_distance_m: float | None,
) -> Lens:
    """Return a lens as the options of `pixsim lens` change it; None leaves it as its file has it.

    Raises PixsimError as the methods of `Lens` do.
    """
    if focal_length_mm is not None:
        factor = focal_length_mm / lens.first_order(lens.primary_nm).focal_length_mm
        lens = replace(lens.scaled(factor), object_distance_mm=factor * lens.object_distance_mm)
    if f_number is not None:
        lens = lens.stopped_down(f_number)
    if field_deg is not None:
        lens = lens.with_same_rays(max_field_deg=field_deg)
    if refocus is not None or object_distance_m is not None:
        distance = lens.object_distance_mm if object_distance_m is None else 1e3 * object_distance_m
        lens = lens.refocused(refocus or "axis", distance)  # type: ignore[arg-type]
    return lens
