"""Benchmarks: tiegraph and its competitors on the same images, against the same truth (see README.md)."""
