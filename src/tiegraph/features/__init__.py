"""Key points, COLMAP's database, matching and verification of exactly the listed pairs.

``matchers`` finds which descriptors match, exactly and natively (``native/nearest``); COLMAP verifies the matches.
Errors in COLMAP's threads abort the process, so matching runs in child processes (``tiegraph.child``) whose abort
becomes an error with the end of the log. ``database.db`` is rewritten after ``match``, so that its bytes do not depend
on the order in which blocks were finished. Key points whose support reaches into the mask are left out: they are biased
towards the sky.
"""
