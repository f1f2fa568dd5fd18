"""The registry of notes: what a user should be told besides a result, by id."""

from __future__ import annotations

from typing import NamedTuple


class _NoteKind(NamedTuple):
    """A kind of note: notes on which a user would act alike.

    template : its text, with the names of its values in braces
    doubts : whether numbers may not be of what was asked for, stated or measured. --quiet hides the
        other notes: assumptions where nothing is stated, settings that change no number, and how
        sure an optimum is
    """

    template: str
    doubts: bool = False


NOTES = {
    # --- settings
    # Another setting or file decides in place of a setting.
    "not_used": _NoteKind("{setting} is not used: {reason}", True),
    # Numbers are the same without a setting, an axis or draws.
    "no_effect": _NoteKind("{words}"),
    # A number is not stated, and taken from elsewhere.
    "assumed": _NoteKind("{words}"),
    # A number is unusual in its unit, and usual in another one.
    "unit_slip": _NoteKind("{name} = {number:g} is unusual. {hint}", True),
    # Some of the pixel sizes or cases are not possible.
    "left_out": _NoteKind("{words}", True),
    # Motion leaves other borders in other cases.
    "unequal_margins": _NoteKind(
        "motion leaves different parts of the frame to score in different cases; with"
        " motion.margin_um = {margin_um:g} all cases score the same part",
        True,
    ),
    # --- files
    # A file can be read in several ways, or not all of it is used.
    "file_as_read": _NoteKind("{words}", True),
    # The file results.csv is of other settings or another version, or damaged.
    "rows_not_continued": _NoteKind("results: {rows}. The file is kept as '{backup}'{then}"),
    # --- lenses
    # A lens file leaves a choice, names catalogues that pixsim lacks, or holds what is not used.
    "lens_as_read": _NoteKind("{lens}: {words}", True),
    # A lens of the user's is scaled to the die.
    "lens_scaled": _NoteKind(
        "lens '{lens}' of {focal_mm:.5g} mm is scaled so that its largest field reaches the corner"
        " of the die: lens.focal_length_mm = {focal_mm:.5g} keeps the size stated in its file",
        True,
    ),
    # The image circle of a lens is smaller than the die.
    "image_circle": _NoteKind(
        "{share} of the die lies beyond the image circle of '{lens}', where no light arrives", True
    ),
    # The blur of a real lens has an error above its tolerance, or an unknown one out of focus.
    "lens_blur": _NoteKind("{words}", True),
    # Nothing in view is in focus.
    "focus": _NoteKind(
        "nothing in view is in focus: the camera focuses at {focus_m} m, and the scene is at"
        " {place}, where points are discs of {disc_um} µm or more, {disc_px} pixels of {pitch_um:g}"
        " µm. The focus is {setting} or, without it, the focus_distance of the scene, both in"
        " metres",
        True,
    ),
    # --- scene and light
    # A scene has colours, tables, skies or lamps that Mitsuba or the bands do not hold in full.
    "scene": _NoteKind("{words}", True),
    # A surface sends back more light than it gets.
    "reflectance": _NoteKind(
        "{what} is {highest:g} in {place}: this surface reflects more light than it receives; 1"
        " reflects all of it",
        True,
    ),
    # The spectral bands do not reach the tolerance of the mean electrons.
    "electrons_error": _NoteKind(
        "the error of the mean electrons is up to {error:.1e}, above the tolerance {tolerance:g}:"
        " {limits}",
        True,
    ),
    # A lamp gives light outside the range that is computed.
    "light_left_out": _NoteKind("{words}: {hint}", True),
    # A render ends before its noise is at the target, or its noise counts as signal.
    "render_noise": _NoteKind("{words}", True),
    # A file of light has too few bands or samples, or samples as of fireflies.
    "light_file": _NoteKind("'{file}' {words}", True),
    # Light was rendered for another camera.
    "other_camera": _NoteKind(
        "the irradiance was rendered for a camera with different {names}", True
    ),
    # --- display
    # More than 1 % of the ideal image is brighter than display white.
    "white_clipped": _NoteKind(
        "{share} of the ideal image is brighter than display white; {hint}", True
    ),
    # --- pixel
    # A pixel's stack is beyond the limits of its model.
    "stack_model": _NoteKind("pixel.stack at {pitch_um:g} µm: {words}", True),
    # Electrons are of light for which a quantum efficiency, a glass or the eye has no numbers.
    "spectral_range": _NoteKind("{words}", True),
    # The black level clips dark noise visibly.
    "black_level": _NoteKind(
        "the black level of {black_level_dn:g} DN clips dark noise{where}: {percent:.0f} % of dark"
        " pixels are at 0 DN, which raises the dark mean by {excess_e} e- (ΔE {lightness} on"
        " uniform black, less on grey); {hint}",
        True,
    ),
    # --- results
    # Automatic exposure gives a sensor that loses light more time.
    "filled_alike": _NoteKind(
        "automatic exposure fills all alike, the brightest pixel to {percent:.0f} % of the full"
        " well, in {shortest} to {longest}: a lower quantum efficiency costs time, not noise. For"
        " equal exposure: {setting}"
    ),
    # ΔE is of codes, contrast, saturation or missing light, not of noise and blur.
    "cause": _NoteKind("{words}: {hint}", True),
    # The error of the film or of the render is above its limit.
    "not_converged": _NoteKind("{words}", True),
    # A metric has no number for a frame, or a fit leaves sizes out.
    "undefined_metric": _NoteKind("{words}", True),
    # The interval of an optimum is open, or wider than target_ci_um.
    "interval": _NoteKind("{case}: the interval is {words}"),
    # --- pictures of edges
    # A picture looks clipped, sharpened or filtered.
    "edge_picture": _NoteKind("edge picture: {words}", True),
    # An edge is bent, or unevenly lit.
    "edge_region": _NoteKind("edge picture: {words}", True),
    # A measurement of a data sheet has a limit, or another setting than was asked for.
    "data_sheet": _NoteKind("{words}", True),
    # --- this machine
    # A processor, a graphics card, a worker, a cache or a disk is not as usual.
    "machine": _NoteKind("{words}"),
    # A library warns.
    "other": _NoteKind("{words}", True),
}
