"""The version of tiegraph, where every layer can ask for it."""

__version__ = "0.1.0"
