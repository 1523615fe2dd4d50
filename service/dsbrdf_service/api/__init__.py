"""Define the HTTP resources: each module has the routes of one resource with their documents and parameters.

Resources are `fits`, `results`, `values`, `measurements`, `pictures` and `about`. `context` has the dependencies of
routes; `fields` and `points` define documents and parameters that several routes use.
"""
