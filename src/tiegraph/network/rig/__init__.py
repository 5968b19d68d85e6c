"""The rig compared with the images: which cameras see the same surface, their order, their synchronisation."""
