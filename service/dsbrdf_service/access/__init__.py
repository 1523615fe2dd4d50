"""Admit requests that have an API key, and requests of the local user, who needs no key.

`keys` reads API keys and their limits from the database; `authentication` admits or refuses requests.
"""
