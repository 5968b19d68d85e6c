"""The command line, generated from the settings classes."""
