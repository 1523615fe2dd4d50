"""The life of a fit, and the models of finished fits.

`jobs` runs fits and lets requests wait for them; `model_cache` keeps the models used last in memory.
"""
