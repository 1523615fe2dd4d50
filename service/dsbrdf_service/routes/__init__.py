"""The routes, one module for each resource: a route parses, makes one call and returns a document.

`fits` and their export, `measurements`, `brdf` values and components, `figures`, `about` health and metrics; `page` the
files of the web page; `dependencies` what routes are given.
"""
