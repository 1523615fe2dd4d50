"""The resources, a file each with its route, documents and parameters.

`fits`, `exports`, `values`, `components`, `measurements`, `tables`, `pictures`, `about`; `context` what routes are
given, `fields` and `points` what several of them read, `uploads` how a file is received.
"""
