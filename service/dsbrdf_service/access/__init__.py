"""Who may send requests, and how many: API keys and the users without one.

`keys` the keys, in the database and in memory, with their limits; `authentication` the middleware.
"""
