"""The tables of the five papers: their own numbers, ours, their recipes as built here, and COLMAP's.

    python -m benchmarks.papers 000                 # prints what `benchmarks/results/papers.json` holds
    TIEGRAPH_DATA=... python -m benchmarks.papers 000 --run --work DIR      # measures what is missing there

``printed`` has the papers' numbers with page or table, ``scenes`` the surveys that stand for theirs, ``measure`` runs
and keeps, ``tables`` prints.
"""
