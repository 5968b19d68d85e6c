"""A close-range rig like paper 004's simulated in full: boards, stations round an object, and what tiegraph makes of
them (``world``: the object and its images; ``__main__``: the commands and the table)."""
