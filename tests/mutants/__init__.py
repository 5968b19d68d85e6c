"""Deliberate mistakes in what the papers' equations, tables and thresholds say, and the test that catches each.

    python -m tests.mutants                # all; --only 002 or a word of a mistake for some
    python -m tests.mutants --jobs 2

``table`` lists them by paper. Each is made in a copy of the sources, where its test must fail; survivors are named and
the exit code is 1. The normal tests only see that each mistake can still be made (``test_mutants``).
"""
