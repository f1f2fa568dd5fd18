"""The registry of notes: what a user should be told besides a result, by id."""

from __future__ import annotations

from typing import NamedTuple


class NoteKind(NamedTuple):
    """A kind of note: notes on which a user would act alike.

    when : what causes it
    template : its text, with the names of its values in braces
    doubts : whether numbers may not be of what was asked for, stated or measured. --quiet hides the other notes: what is assumed
        where nothing is stated, what changes no number, and how sure an optimum is
    """

    when: str
    template: str
    doubts: bool = False


NOTES = {
    # --- settings ------------------------------------------------------------------------------------------------------
    "not_used": NoteKind("another setting or file decides in place of a setting", "{setting} is not used: {reason}", True),
    "no_effect": NoteKind("numbers are the same without a setting, an axis or draws", "{words}"),
    "assumed": NoteKind("a number is not stated, and taken from elsewhere", "{words}"),
    "unit_slip": NoteKind(
        "a number is unusual in its unit, and usual in another one", "pixel: {name} = {number:g} is unusual. {hint}", True
    ),
    "left_out": NoteKind("some of the pixel sizes or cases are not possible", "{words}", True),
    "unequal_margins": NoteKind(
        "motion leaves other borders in other cases",
        "what moves leaves other parts of the frame to score in other cases; motion.margin_um = {margin_um:g} "
        "lets all score the same",
        True,
    ),
    # --- files ---------------------------------------------------------------------------------------------------------
    "file_as_read": NoteKind("a file can be read in several ways, or not all of it is used", "{words}", True),
    "rows_not_continued": NoteKind(
        "results.csv is of other settings or another version, or damaged", "results: {rows}. The file is kept as '{backup}'{then}"
    ),
    # --- lenses --------------------------------------------------------------------------------------------------------
    "lens_as_read": NoteKind(
        "a lens file leaves a choice, names catalogues that pixsim lacks, or holds what is not used", "{lens}: {words}", True
    ),
    "lens_scaled": NoteKind(
        "a lens of the user's is scaled to the die",
        "lens '{lens}' of {focal_mm:.5g} mm is scaled so that its largest field reaches the corner of the die: "
        "lens.focal_length_mm = {focal_mm:.5g} leaves it as it is in its file",
        True,
    ),
    "image_circle": NoteKind(
        "the image circle of a lens is smaller than the die",
        "{share} of the die lies beyond the image circle of '{lens}', where no light arrives",
        True,
    ),
    "lens_blur": NoteKind(
        "the blur of a real lens has an error above its tolerance, or an unknown one out of focus", "{words}", True
    ),
    "focus": NoteKind(
        "nothing in view is in focus",
        "nothing in view is in focus: the camera focuses at {focus_m} m, and the scene is at {place}, where points are discs "
        "of {disc_um} µm or more, {disc_px} pixels of {pitch_um:g} µm. The focus is {setting} or, without it, the "
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
    "render_noise": NoteKind("a render ends before its noise is at the target, or its noise counts as signal", "{words}", True),
    "light_file": NoteKind("a file of light has too few bands or samples, or samples as of fireflies", "'{file}' {words}", True),
    "other_camera": NoteKind(
        "light was rendered for another camera",
        "the irradiance was rendered with another camera than the one given, of another {names}",
        True,
    ),
    # --- display -------------------------------------------------------------------------------------------------------
    "white_clipped": NoteKind(
        "more than 1 % of the ideal image is brighter than display white",
        "{share} of the ideal image is brighter than display white; {hint}",
        True,
    ),
    # --- pixel ---------------------------------------------------------------------------------------------------------
    "stack_model": NoteKind("a pixel's stack is beyond the limits of its model", "pixel.stack at {pitch_um:g} µm: {words}", True),
    "spectral_range": NoteKind(
        "electrons are of light for which a quantum efficiency, a glass or the eye has no numbers", "{words}", True
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
    "undefined_metric": NoteKind("a metric has no number for a frame, or a fit leaves sizes out", "{words}", True),
    "interval": NoteKind("the interval of an optimum is open, or wider than target_ci_um", "{case}: the interval is {words}"),
    # --- pictures of edges ---------------------------------------------------------------------------------------------
    "edge_picture": NoteKind("a picture looks clipped, sharpened or filtered", "edge picture: {words}", True),
    "edge_region": NoteKind("an edge is bent, or unevenly lit", "edge picture: {words}", True),
    "data_sheet": NoteKind("a measurement of a data sheet has a limit, or another setting than was asked for", "{words}", True),
    # --- this machine --------------------------------------------------------------------------------------------------
    "machine": NoteKind("a processor, a graphics card, a worker, a cache or a disk is not as usual", "{words}"),
    "other": NoteKind("a library warns", "{words}", True),
}
