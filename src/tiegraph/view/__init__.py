"""A finished run in the browser: its cloud, cameras, tie graph and rasters, and what is known of a place on them.

``layers`` makes of results what the page draws, and says of a picked place its coordinates, its sigma and the images
that see it, by functions of arrays. ``page.html`` and ``view.js`` are the page. The script is a bundle of
``web/src`` with three.js, copc.js and laz-perf (``licences.txt``), so that nothing is fetched from elsewhere: a survey
stays on its machine. The cloud is streamed from its COPC file: the page asks for the nodes that it shows, by ranges of
bytes.

A graphics card counts with seven digits. All that is drawn is therefore *local*: coordinates of the CRS minus the
middle of the cloud. A place that was picked is looked up again in the file, in full precision.
"""
