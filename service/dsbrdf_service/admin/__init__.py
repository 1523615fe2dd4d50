"""Define the commands ``dsbrdf serve``, ``keys``, ``purge`` and ``doctor``, each in a module with a function `main`.

All commands except `serve` may be used while a server runs. These commands import neither NumPy nor
pydantic nor FastAPI, so that they start at once.
"""
