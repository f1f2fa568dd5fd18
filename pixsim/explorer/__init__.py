"""A page of this machine on which settings are turned and the picture is seen: `pixsim explore`,
`pixsim.explore`.

In come a scene, or light, and settings; out go pictures, numbers with their errors, commands and
settings files. Everything is computed by `studies/run.py`, as `pixsim run` does, and said as by
`report/run.py`. It imports what these do, and `report`.
"""
