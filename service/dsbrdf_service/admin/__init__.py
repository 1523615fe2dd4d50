"""Define the commands of an operator: `serve` has ``dsbrdf serve``, `commands` has ``keys``, ``purge`` and ``doctor``.

The latter may be used while a server runs. They import neither NumPy nor pydantic nor FastAPI, so that they start at
once.
"""
