"""What stands between a stranger's scene and pixsim: no scene ends a command without a word.

A scene's XML is inspected before Mitsuba sees it (`inspector`; `plugins`: what it may use), and it is traced where it may crash or
hang (`tracer`: in this process or in a `child`, which checks its files: `loaded`). The rest of `scene` comes in by two doors:
`inspector.open_scene` and `tracer.tracer_of`.
"""
