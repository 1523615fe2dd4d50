"""The life of a fit.

`fit_queue` runs fits and lets requests wait for them; `turns` shares places fairly between owners; `fit_options`
converts options to JSON and back.
"""
