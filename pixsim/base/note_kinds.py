"""The registry of notes: what a user should be told besides a result, by id."""

from __future__ import annotations

from typing import NamedTuple


class NoteKind(NamedTuple):
    """A kind of note.

    when : what causes it
    template : its text, with the names of its values in braces
    doubts : whether a number of the result may be wrong, or not what was asked for. --quiet hides the other notes, which are advice
    """

    when: str
    template: str
    doubts: bool = False


NOTES = {
    # --- settings ------------------------------------------------------------------------------------------------------
    "not_used": NoteKind("another setting or file decides in place of a setting", "{setting} is not used: {reason}", True),
    "no_effect": NoteKind("numbers and pictures are the same without a setting", "{names} {verb} nothing here"),
    "idle_axis": NoteKind("all values of an axis give equal numbers", "the axis {axis} changes nothing: {reason}", True),
    "mixed_sensors": NoteKind("several files state [pixel]", "[pixel] is a mixture of {count} files. {parts}"),
    "assumed": NoteKind("a number of a pixel or a lens is not stated, and taken from elsewhere", "{words}"),
    "unit_slip": NoteKind(
        "a number is unusual in its unit, and usual in another one", "pixel: {name} = {number:g} is unusual. {hint}", True
    ),
    "smaller_range": NoteKind(
        "the die, a stack or the memory allows fewer pixel sizes than asked for",
        "the {end} pixel size{whose} is {pitch_um:.4g} µm in place of {wished_um:.4g} µm: {reason}",
    ),
    "unequal_margins": NoteKind(
        "motion leaves other borders in other cases",
        "what moves leaves other parts of the frame to score in other cases; motion.margin_um = {margin_um:g} "
        "lets all score the same",
        True,
    ),
    "nothing_drawn": NoteKind("--uncertainty finds nothing to draw", "{what}: nothing is drawn, since {reason}"),
    # --- files ---------------------------------------------------------------------------------------------------------
    "file_as_read": NoteKind("a file can be read in several ways, or not all of it is used", "{words}"),
    "per_cent": NoteKind(
        "a table states per cent and has no value above 1",
        "'{path}' states per cent, and no value is above {highest:g} %: it is read so. Fractions have no % in their title",
        True,
    ),
    "rows_not_continued": NoteKind(
        "results.csv is of other settings or another version, or damaged", "results: {rows}. The file is kept as '{backup}'{then}"
    ),
    "of_another_version": NoteKind(
        "settings.toml is of a preview of pixsim",
        "settings '{path}' state {version}: their results may differ from those beside them; write them anew",
        True,
    ),
    # --- lenses --------------------------------------------------------------------------------------------------------
    "lens_as_read": NoteKind("a lens file leaves a choice, or holds what pixsim does not use", "lens '{lens}': {words}"),
    "lens_scaled": NoteKind(
        "a lens of the user's is scaled to the die",
        "lens '{lens}' of {focal_mm:.5g} mm is scaled so that its largest field reaches the corner of the die: "
        "lens.focal_length_mm = {focal_mm:.5g} leaves it as it is in its file",
    ),
    "lens_stops_light": NoteKind(
        "a lens file has semi-diameters or vignetting factors that do, or would, stop rays", "lens '{lens}': {words}"
    ),
    "lens_fields": NoteKind("rays of a lens's largest field cannot be traced", "lens '{lens}': {words}", True),
    "glass_elsewhere": NoteKind(
        "a glass is taken from a catalogue that the lens file does not name",
        "{where}: {glass} is taken from {catalogue}; the file names catalogues that pixsim lacks ({missing})",
    ),
    "glass_range": NoteKind(
        "electrons are of light for which a lens's glasses are not known",
        "{share:.1%} of the electrons are of light outside {low_nm:.4g} to {high_nm:.4g} nm, where the glasses of '{lens}' are not "
        "known: it is blurred with the wavefronts of the nearest of these. An infrared filter (pixel.infrared_cut_nm) keeps it out",
        True,
    ),
    "image_circle": NoteKind(
        "the image circle of a lens is smaller than the die",
        "{share:.1%} of the die lies beyond the image circle of '{lens}', where no light arrives",
    ),
    "lens_defocus": NoteKind(
        "a scene has depth that a real lens blurs in another way than a thin one",
        "what is out of focus gets a thin lens's disc and the blur that the real lens has in focus, which is wrong by more than "
        "{limit:.1%}: {largest}{right}",
        True,
    ),
    "lens_blur": NoteKind(
        "tiles or film are too coarse for the blur of a real lens",
        "the blur of the real lens has an rms error {size}: {reason}",
        True,
    ),
    "focus": NoteKind(
        "nothing in view is in focus",
        "nothing in view is in focus: the camera focuses at {focus_m:.4g} m, and the scene is at {place}, where points are discs "
        "of {disc_um:.3g} µm or more, {disc_px:.3g} pixels of {pitch_um:g} µm. The focus is {setting} or, without it, the "
        "focus_distance of the scene, both in metres",
        True,
    ),
    # --- scene and light -----------------------------------------------------------------------------------------------
    "scene": NoteKind("a scene has colours, tables, skies or lamps that Mitsuba or the bands do not hold in full", "{words}", True),
    "reflectance": NoteKind(
        "a surface sends back more light than it gets",
        "{what} is {highest:g} in {place}: a surface that sends back more light than it gets; 1 is all of it",
        True,
    ),
    "electrons_error": NoteKind(
        "the spectral bands do not reach the tolerance of the mean electrons",
        "the error of mean electrons is up to {error:.1e}, above the tolerance {tolerance:g}: {limits}",
        True,
    ),
    "light_left_out": NoteKind("a lamp gives light outside the range that is computed", "{words}: {hint}", True),
    "graphics_card": NoteKind(
        "a graphics card fails in a render", "rendering with {variant}, since the graphics card failed: {error}"
    ),
    "render_noise": NoteKind("a render ends before its noise is at the target", "{cause}: {remains}. {hint}", True),
    "target_noise": NoteKind(
        "the light without a target has render noise",
        "the light has render noise of {noise:.2g} %: what of it differs without the target counts as signal",
        True,
    ),
    "outliers": NoteKind(
        "light of another program has samples as of fireflies",
        "'{file}' has samples that stand alone, more than {limit:g} times all others ({named}), as fireflies of a path tracer do: "
        "the automatic exposure is as if they were like their neighbours. Remove them at their source",
        True,
    ),
    "wide_bands": NoteKind(
        "light has bands too wide for lines and filters",
        "'{file}' has {count} bands of up to {width_nm:g} nm: they stand for {low_nm:g}-{high_nm:g} nm, with the light uniform "
        "within each and none outside. Colour and quantum efficiency need bands of {limit_nm:g} nm or less",
        True,
    ),
    "reduced_light": NoteKind(
        "irradiance.exr was written with --irradiance reduced",
        "'{file}' holds means over {factor:.4g} × {factor:.4g} samples of the render, {pitch_um:.4g} µm wide: what is finer is "
        "lost, and results differ; pixsim run --irradiance full keeps it",
        True,
    ),
    "other_camera": NoteKind(
        "light was rendered for another camera",
        "the irradiance was rendered with another camera than the one given, of another {names}",
        True,
    ),
    # --- display -------------------------------------------------------------------------------------------------------
    "white_estimated": NoteKind(
        "neither the scene nor a setting states the white",
        "the scene does not define its white: using {white:g} {unit}, {source}; {hint}",
    ),
    "white_clipped": NoteKind(
        "more than 1 % of the ideal image is brighter than display white",
        "{share:.0%} of the ideal image is brighter than display white; {hint}",
        True,
    ),
    # --- pixel ---------------------------------------------------------------------------------------------------------
    "stack_model": NoteKind("a pixel's stack is beyond the limits of its model", "pixel.stack at {pitch_um:g} µm: {words}", True),
    "channel_scales": NoteKind(
        "the channels of a camera's sensitivities were scaled one by one",
        "pixel.colour.sensitivities: each channel of {camera} was scaled to its own peak; their ratio is unknown, and with it the "
        "noise before white balance. Balanced colours do not depend on it",
        True,
    ),
    "table_ends": NoteKind(
        "a table of quantum efficiency ends within the light",
        "{name} ends at {end_nm:g} nm with {last:g}, and is 0 beyond: if it stayed so, {share:.0%} of the electrons would come "
        "from there. Extend the table, or state a filter ({setting})",
        True,
    ),
    "flat_efficiency": NoteKind(
        "one quantum efficiency for all wavelengths differs from the absorption of silicon",
        "pixel.quantum_efficiency = {efficiency:g} holds at every wavelength; if it was measured at {usual_nm:g} nm, the "
        "absorption of silicon would make {change:.0%} {more} electrons of this light. State its wavelength "
        "({setting}), or a table",
        True,
    ),
    "infrared": NoteKind(
        "colour channels get infrared",
        "infrared beyond {limit_nm:g} nm is {channels}, which no eye sees: it is part of the colour error. A filter keeps it out "
        "({setting})",
    ),
    "black_level": NoteKind(
        "the black level clips dark noise visibly",
        "the black level of {black_level_dn:g} DN clips dark noise{where}: {percent:.0f} % of dark pixels are at 0 DN, which "
        "raises the dark mean by {excess_e} e- (ΔE {lightness} on uniform black, less on grey); {hint}",
        True,
    ),
    # --- results -------------------------------------------------------------------------------------------------------
    "cause": NoteKind("ΔE is of codes, contrast, saturation or missing light, not of noise and blur", "{words}: {hint}", True),
    "not_converged": NoteKind("the error of the film or of the render is above its limit", "{words}", True),
    "undefined_metric": NoteKind("a metric has no number for a frame", "{words}", True),
    "sizes_left_out": NoteKind("a sensor cannot have some of the pixel sizes", "{case}: {sizes} µm left out: {reason}"),
    "case_left_out": NoteKind("no pixel of a case is possible", "a case is left out: {reason}", True),
    "interval_wide": NoteKind(
        "an optimum misses target_ci_um",
        "{case}: the interval is {width} after {limit}; the target is ± {target_um} µm (target_ci_um)",
    ),
    "interval_open": NoteKind(
        "an end of the sizes may be the best",
        "{case}: the interval is open, since the {end} size tried, {pitch_um:.4g} µm, may be the best; {hint}",
    ),
    "sizes_without_number": NoteKind(
        "the fit of a metric leaves sizes out", "{metric} {why} at {sizes} µm, and its fitted curve does without{reason}", True
    ),
    # --- pictures of edges ---------------------------------------------------------------------------------------------
    "edge_channel": NoteKind(
        "a picture states no layout of its colour filters",
        "the picture states no layout: green is taken to be at {places} (row,column) of 2 × 2 pixels, which agree with each other",
    ),
    "edge_black": NoteKind(
        "the dark side is below black",
        "edge picture: the dark side is below black by {share:.1%} of the step: the black level is too high for the contrast",
        True,
    ),
    "edge_clipped": NoteKind("a side of an edge looks clipped", "edge picture: {words}: this sharpens the edge", True),
    "edge_shape": NoteKind(
        "an edge is no polynomial",
        "edge picture: the edge is no polynomial of degree {degree}: its rows scatter about it by {misfit_px:.2g} px (RMS), which "
        "lowers the SFR at Nyquist by about {loss:.0%}; take a region in which it is even",
        True,
    ),
    "edge_sharpened": NoteKind(
        "an SFR is above 1",
        "edge picture: {cause}: the SFR is {sfr:.3g} at {frequency_cy_per_px:.3f} cy/px; the noise leaves {low:.3g} to {high:.3g}",
        True,
    ),
    "edge_shading": NoteKind(
        "light changes beside an edge",
        "edge picture: shading: beside the edge the light changes by {change:.1%} of the step within {distance_px:g} px, which the "
        "SFR takes for blur or sharpening at low frequency; correct the picture with a flat field, or take a smaller region",
        True,
    ),
    "edge_noise": NoteKind(
        "noise of neighbouring pixels is correlated",
        "edge picture: the noise of neighbouring pixels is correlated ({correlation:.2f}), as after demosaicking, denoising or "
        "scaling: the intervals are too narrow",
        True,
    ),
    "edge_encoded": NoteKind(
        "a picture states an encoding for displays",
        "'{path}' states an encoding for displays ({encoding}): the SFR is that of light only if the values are linear in it",
        True,
    ),
    "data_sheet": NoteKind("the measurements of a data sheet have a limit or a choice", "{words}", True),
    # --- this machine --------------------------------------------------------------------------------------------------
    "machine": NoteKind("a processor, a worker, a cache or a disk is not as usual; results are the same", "{words}"),
    "other": NoteKind("a library warns", "{words}", True),
}
