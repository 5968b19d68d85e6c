"""Competitor: pycolmap, every image against every other, all defaults."""

from colmap import arguments, run

if __name__ == "__main__":
    import pycolmap

    run(arguments(__doc__), pycolmap.match_exhaustive)
