"""The routes, one module for each resource: a route parses, makes one call and returns a document.

`fits` and their export, `measurements`, `brdf` values and components, `about` health and metrics; `page` the web pages;
`dependencies` what they are given.
"""
