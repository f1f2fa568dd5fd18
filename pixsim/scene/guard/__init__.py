"""What stands between a stranger's scene and pixsim: no scene ends a command without a word.

A scene is inspected before Mitsuba sees it (`inspector`: its XML; `assets`, `meshes`: its files; `plugins`: what it may use), and
traced where it may crash or hang (`tracer`: in this process or in a `child`). The rest of `scene` comes in by two doors:
`inspector.open_scene` and `tracer.tracer_of`.
"""
