"""The commands ``dsbrdf serve``, ``keys``, ``purge`` and ``doctor``, a module each, which has a `main`.

All but `serve` work on a data folder beside a running server too; they import neither NumPy nor pydantic nor
FastAPI, so that they answer at once.
"""
