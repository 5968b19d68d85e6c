"""Glue of watch: files that arrive become previews, ties and poses; the page shows what is known.

``loop`` takes one step after another in this process; ``ties`` makes previews and matches them as the stages preview
and candidates do; ``model`` makes the coarse model in a child, one at a time; ``shown`` says what the page shows. What
is kept in the run folder are previews, ties and the page as it was last: a second run goes on from there.
"""
