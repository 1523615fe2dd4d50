"""Run computations for requests.

`computations` runs equal computations once, in fair turns of the callers; `steps` has the functions that run in
separate processes; `models` caches fitted models.
"""
