"""One small file a competitor; each is a program run in its own process by run.py."""
