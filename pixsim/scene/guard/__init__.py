"""What stands between a stranger's scene, or this machine's drivers, and pixsim: nothing of either ends a command without a word.

A scene is inspected before Mitsuba sees it (`inspector`: its XML; `assets`, `meshes`: its files; `plugins`: what it may use), and
traced where it may crash or hang (`tracer`, `child`, `worker`). What may abort on this machine is tried first (`trial`, `checks`,
`graphics`, `variant`). The rest of `scene` asks `open_scene`, a `Tracer`, and the variant that works.
"""
