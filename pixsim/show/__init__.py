"""Arrays and words to what people look at: figures with their tables, PNG pictures, HTML pages of one file.

It knows no result: axes and words are made by the callers.
May import: base.
"""
