"""The life of a fit, and what is kept of finished fits.

`jobs` runs fits and lets requests wait for them; `results` keeps the models used last in memory;
`computations` is how requests compute anything else, and `steps` what of it takes a process of its own.
"""
