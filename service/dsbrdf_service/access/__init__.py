"""Who may send requests, and how many: API keys and the users without one.

`keys` the keys, with their limits; `authentication` who is let in.
"""
