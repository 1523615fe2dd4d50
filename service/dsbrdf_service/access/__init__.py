"""Control access by API keys, and by users of this machine without a key.

`keys` reads the keys with their limits; `authentication` admits or refuses requests.
"""
