"""Queue and run fits.

`fit_queue` runs fits and lets requests wait for them; `turns` lets owners take fair turns; `fit_options` converts
options to JSON and back.
"""
