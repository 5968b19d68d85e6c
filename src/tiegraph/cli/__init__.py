"""The command line, generated from the settings classes.

``tiegraph --help``, ``--version``, ``run --help`` and a wrong verb load no engine and no library: ``verbs`` names
modules, and repeats what stages make (a test compares it with ``STAGES``). A verb is loaded with pycolmap, then the
signals that pycolmap took over are taken back (``main``). The short page of ``run`` is written by hand (``verbs``; a
test compares it with the options), all other help is made by tyro. What is printed is not read as markup: brackets
stay.
"""
