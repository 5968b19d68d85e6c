"""Campaigns against the command line: kills, full disks, corrupt inputs, damaged artefacts. See README.md here."""
