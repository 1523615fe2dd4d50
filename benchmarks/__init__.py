"""Benchmarks: ``python -m benchmarks [name [options]]``, each in a process of its own, on one core, with one table."""
