"""Competitor: pycolmap with the rig (its own rig configuration), every image against every other, else all defaults."""

from colmap import arguments, run

if __name__ == "__main__":
    import pycolmap

    run(arguments(__doc__), pycolmap.match_exhaustive, with_rig=True)
