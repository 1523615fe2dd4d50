"""From bytes and text to the library's objects, and back.

`inputs` what clients send; `schemas` the documents that they get; `fit_options`; `names`; `points` at which values are
wanted.
"""
