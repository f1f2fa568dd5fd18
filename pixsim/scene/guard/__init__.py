"""Guards against scenes of strangers: no scene ends a command without a message.

A scene's XML is inspected before Mitsuba sees it (`inspector`; `plugins`: what it may use), and it
is traced where it may crash or hang: in a `child`, which checks its files (`loaded`). pixsim's own
scenes are traced in this process (`in_process`). A `dictionary` is written as XML first. The rest
of pixsim comes in by four doors: `dictionary.scene_and_parameters`, `inspector.open_scene`,
`child.ChildTracer` and `in_process.InProcessTracer`.
"""
