"""Another value of each setting of a study."""

# Another value of each setting, and the stages that it makes anew where the light is the same: a
# light states in its header what it depends on, so that its hash alone tells of a render.
CHANGES: dict[str, tuple[object, str]] = {
    "scene": ({"file": "flat"}, "light"),
    "camera": ({"f_number": 5.6}, "light"),
    "lens": ({"file": "phone"}, "light"),
    "tolerance_e": (2e-3, "light"),
    "render_noise": (0.4, "light"),
    "resolution": (77, "light"),
    "max_seconds": (9.0, "light"),
    "window_mm": (0.5, "light"),
    "tolerance_delta_e": (1e-6, "light score"),  # which asks for double precision
    "pitch": ({"values_um": (6.0, 7.0, 8.0, 9.0, 16.0)}, "light score"),
    "exposure": ({"well_target": 0.5}, "light frame score"),
    "motion": ({"image_um_per_s": (3.0, 0.0)}, "light frame score"),
    "correction": ({"dark_frames": 4}, "light frame score"),
    "develop": ({"matrix": "noise_aware"}, "light score"),
    "display": ({"gamma": 1.8}, "light score"),
    "metrics": (("delta_e", "acutance"), "score"),
    "metric": ({"information": {"contrast": 0.3}}, ""),  # of a metric that nobody asks for
    "pixel": ({"prnu": 0.02}, "light frame score"),
    "process": ({"0.35um": {"dsnu": 0.6}}, "light frame score"),
    "technologies": (("0.35um", "0.25um"), "light"),
    "sensors": (
        {
            "one.toml": {
                "pitch_um": 6.0,
                "full_well_e": 1e4,
                "read_noise_e": 2.0,
                "quantum_efficiency": 0.5,
            }
        },
        "light",
    ),
    "seed": (9, "light frame score"),
    "name": ("another", "frame score"),
    "streams": ("another", "frame score"),
    "repeats": (5, ""),
    "max_repeats": (50, ""),
    "target_ci_um": (0.5, ""),
    "max_evaluations": (1000, ""),
    "refine": (False, ""),
    "axis": (({"name": "f", "set": "camera.f_number", "values": (4.0, 8.0)},), ""),
    "condition": (({"name": "day", "set": {"camera": {"f_number": 4.0}}},), ""),
    "title": ("another", ""),
    "iso_delta_e": (2.0, ""),
    "detail": ((0.25, 0.75), ""),
    "paper": (True, ""),
    "sources": ({"seed": "here"}, ""),
    "noise_budget": (True, ""),
}
