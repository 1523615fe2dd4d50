"""Define the commands ``dsbrdf serve``, ``keys``, ``purge`` and ``doctor``, each by a module with a `main`.

All commands except `serve` may be used while a server runs. They import neither NumPy nor pydantic nor FastAPI, so
that they answer at once.
"""
