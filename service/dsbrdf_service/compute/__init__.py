"""Computations for requests.

`computations` runs each of them once, in fair turns; `steps` has the functions that run in processes of their own;
`models` caches fitted models.
"""
