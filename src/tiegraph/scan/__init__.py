"""The scan stage: a folder of images, videos or panoramas, and what came with it, become a Scene."""
