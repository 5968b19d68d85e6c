"""Benchmarks of structure from motion."""
