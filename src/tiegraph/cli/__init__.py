"""The command line, generated from the settings classes.

``tiegraph --help``, ``--version``, ``run --help`` and a wrong verb load no engine and no library (``verbs``). All help
but the short page of ``run`` is made by tyro. What is printed is not read as markup: brackets stay.
"""
