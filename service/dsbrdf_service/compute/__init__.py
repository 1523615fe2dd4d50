"""Run computations for requests.

`computations` has the turns of the callers and the cache of models; `steps` has the functions that run in separate
processes.
"""
