"""The routes, one module for each resource: a route parses, makes one call and returns a document.

`fits`, `measurements`, `brdf` values and components, `exports`, `about` health, metrics and documentation;
`dependencies` what they are given.
"""
