"""Figures with their tables, PNG pictures and self-contained HTML pages, from arrays and text.

No module here knows a result type: the callers supply axes and text.
May import: base.
"""
