"""Competitor: pycolmap, each image against those that follow it by name, all defaults (no loop detection)."""

from colmap import arguments, run

if __name__ == "__main__":
    import pycolmap

    run(arguments(__doc__), pycolmap.match_sequential)
