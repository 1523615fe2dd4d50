"""The resources: each file has the routes of one resource with their documents and parameters.

Resources are `fits`, `exports`, `values`, `components`, `measurements`, `tables`, `pictures` and `about`. `context` has
the dependencies of routes, `fields` and `points` the inputs that several routes read, `uploads` the reception of files.
"""
