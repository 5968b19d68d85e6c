"""The short help page of `tiegraph run`: one screen of 24 lines of 80 letters, there without loading anything.

Written by hand, for the options' own texts fill 400 lines (`--help-all`); a test holds it to ``cli.run.RunOptions``.
"""

RUN = """\
usage: tiegraph run IMAGES [-o OUT] [OPTIONS]

From a folder of images to the cloud and the report. Run again, it goes on.

inputs:
  IMAGES            the folder of the images, videos or ROS bags; BAG:TOPIC,...
  --rig RIG         rig.toml, rig_config.json, OUT of another run, ring:N, ...
  --camera CAMERA   a single camera's calibration: a file, or MODEL,parameters
  --gnss FILE       CSV, NMEA, .pos, GPX, KML, geo.txt, SBET, MRK, a ROS bag
  --trajectory PATH TUM, EuRoC, KITTI, COLMAP, ...; auto: odometry of the images
  --start MODEL     go on from COLMAP, OpenSfM/ODM, nerfstudio or Metashape
  --gcp, --marks    control and check points; their marks, if in another file
  --times CSV       frames' times where EXIF has none: pass, frame, time

options:
  -o, --out OUT     the run folder (default: <IMAGES>_tiegraph beside them)
  --tolerance M     is it so good in the world, metres? yes, no, or why not told
  --until STAGE     the last stage to run; --plan: say what room, time it needs
  --preset NAME     fast, close-range, conventional, meguro2024 or meguro2025
  --unset KEY       forget a stored input or setting; --keep results: no depths
  --pool POOL       serial, local, local:<workers> or dask:<address>
  --json, --quiet   JSON lines; nothing but errors; --strict: exit 3 if doubtful
  -h, --help        this page; --help-all: all, as --scan.crs, --masks.folder"""
