"""The routes, one module for each resource: a route parses, makes one call and returns a document.

`fits`, `measurements`, `brdf` values and components, `exports`, `health` with metrics, `docs`; `dependencies` what
they are given.
"""
