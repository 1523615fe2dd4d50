"""Access control: API keys, and users without one on this machine.

`keys` reads the keys with their limits; `authentication` admits requests or refuses them.
"""
