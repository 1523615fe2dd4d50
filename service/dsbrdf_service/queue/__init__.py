"""The life of a fit.

`fit_queue` runs fits and lets requests wait for them; `turns` are fair between owners; `fit_options` is the
form of options in JSON.
"""
