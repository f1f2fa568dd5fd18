"""The page of `pixsim explore` and `pixsim.explore`: a user turns settings and sees the picture.

Input: a scene or light, and settings. Output: pictures, numbers with their errors, commands and
settings files. `studies/run.py` computes everything, as for `pixsim run`, and `report/run.py` puts
it into words.
May import: what these two import, and `report`.
"""
