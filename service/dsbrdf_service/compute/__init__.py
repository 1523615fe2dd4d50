"""What requests compute.

`computations` once for all who wait, in turns; `steps` what of it takes a process of its own; `models` keeps the models
used last in memory.
"""
