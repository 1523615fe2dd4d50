"""The command ``dsbrdf``."""
