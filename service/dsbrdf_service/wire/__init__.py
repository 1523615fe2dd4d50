"""From bytes and text to the library's objects, and back.

`schemas` the JSON documents; `fit_options`; `names`; `points` at which values are wanted.
"""
