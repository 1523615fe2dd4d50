"""Scenarios of a real server: a runner, a load generator, programs as clients, and series of crashes and restores."""
