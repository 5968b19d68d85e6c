"""One self-contained HTML report from receipts and artefacts, and the comparison of two runs.

An engine like the others, because ``report`` is a stage like any other: it knows the names of the files in a run
folder and nothing of how they are made.
"""
