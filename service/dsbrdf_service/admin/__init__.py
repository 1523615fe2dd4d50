"""Commands for operators: `serve` runs ``dsbrdf serve``, `commands` runs ``keys``, ``purge`` and ``doctor``.

The latter may be used while a server runs. They import neither NumPy nor pydantic nor FastAPI, so that they start at
once.
"""
