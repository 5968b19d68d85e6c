"""Competitor: pycolmap, every image against every other, all defaults."""

from colmap import arguments, reconstruct

if __name__ == "__main__":
    import pycolmap

    reconstruct(arguments(__doc__), pycolmap.match_exhaustive)
